"""A router on loopback for all tests of this folder, and nodes that are closed at the end of a test."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import closing

import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed: pip install 'murmur-robots[ros2]'")
pytest.importorskip("xxhash", reason="xxhash is not installed: pip install 'murmur-robots[ros2]'")

from protocol.ros2.node import Ros2Node
from protocol.ros2.session import open_router


@pytest.fixture(scope="session")
def router() -> Iterator[str]:
    """Open a router at a free port of loopback; return its address."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    with closing(open_router(address)):
        yield address


@pytest.fixture
def node(router: str) -> Iterator[Callable[..., Ros2Node]]:
    """Return a function that opens a node at the router."""
    opened: list[Ros2Node] = []

    def open_node(name: str, *args: object, **options: object) -> Ros2Node:
        opened.append(Ros2Node(name, *args, router=router, **options))  # type: ignore[arg-type]
        return opened[-1]

    yield open_node
    for each in opened:
        each.close()
