"""A router on loopback for all tests of this folder, and nodes that are closed at the end of a test."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import closing

import pytest
import zenoh

pytest.importorskip("rosbags", reason="rosbags is not installed: pip install 'murmur-robots[ros2]'")
pytest.importorskip("xxhash", reason="xxhash is not installed: pip install 'murmur-robots[ros2]'")

from protocol.ros2.node import Ros2Node
from protocol.ros2.session import open_client, open_router
from tests.protocol.ros2.waiting import spin_until


@pytest.fixture(scope="session")
def router() -> Iterator[str]:
    """Open a router at a free port of loopback; return its address."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    with closing(open_router(address)):
        yield address


@pytest.fixture(scope="session")
def observer(router: str) -> Iterator[zenoh.Session]:
    """Open a session that has no node."""
    with open_client(router) as session:
        yield session


@pytest.fixture
def node(router: str, observer: zenoh.Session) -> Iterator[Callable[..., Ros2Node]]:
    """Return a function that opens a node at the router; at the end, wait until all nodes are gone."""
    opened: list[Ros2Node] = []

    def open_node(name: str, *args: object, **options: object) -> Ros2Node:
        opened.append(Ros2Node(name, *args, router=router, **options))  # type: ignore[arg-type]
        return opened[-1]

    yield open_node
    for each in opened:
        each.close()
    spin_until(lambda: not list(observer.liveliness().get("@ros2_lv/**")))
