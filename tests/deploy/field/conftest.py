"""Tools of the tests of robots in the field."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import closing

import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed: pip install 'murmur-robots[ros2]'")
pytest.importorskip("xxhash", reason="xxhash is not installed: pip install 'murmur-robots[ros2]'")

from protocol.ros2.session import open_router


@pytest.fixture
def router() -> Iterator[str]:
    """Open a router at a free port of loopback; return its address."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    with closing(open_router(address)):
        yield address
