"""Wait for what other threads bring, without a fixed sleep."""

from __future__ import annotations

import time
from collections.abc import Callable

from protocol.ros2.node import Ros2Node

LIMIT_S = 60.0
"""Maximum time until a message arrives; tests fail after it."""


def spin_until(condition: Callable[[], object], *nodes: Ros2Node, now_ns: int = 0) -> None:
    """Let nodes handle what arrives until a condition holds; AssertionError after `LIMIT_S`."""
    deadline = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < deadline, f"the condition did not hold within {LIMIT_S:g} s"
        for each in nodes:
            each.spin(now_ns, 0.01)
        if not nodes:
            time.sleep(0.01)
