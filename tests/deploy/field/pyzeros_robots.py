"""Simulated robots that pyzeros plays: our simulator drives them, an independent library speaks for them.

pyzeros has no transient local publishers. Maps and static transforms are therefore sent again every second.
"""

from __future__ import annotations

import asyncio
import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

# What pyzeros compiles belongs to the environment, not into the working directory.
os.environ.setdefault("CYDR_CACHE_DIR", str(Path(sys.prefix) / "cache" / "cydr"))

pyzeros = pytest.importorskip("pyzeros")

from pyzeros.builtin_msgs import Attachment as PyzerosAttachment  # noqa: E402
from pyzeros.node import Node  # noqa: E402
from pyzeros.qos import QosProfile  # noqa: E402
from pyzeros.sub import RawSub  # noqa: E402

from deploy.scenario.plan import Plan  # noqa: E402
from deploy.serve.ros_robot import RosRobot  # noqa: E402
from deploy.serve.swarm import Swarm  # noqa: E402
from protocol.ros2.messages import Messages  # noqa: E402
from protocol.ros2.qos import Qos  # noqa: E402
from protocol.ros2.session import open_client  # noqa: E402
from tests.protocol.ros2.pyzeros_types import pyzeros_type, to_pyzeros  # noqa: E402

REPEAT_S = 1.0
"""Seconds after which a message that late nodes need is sent again."""


def skip_without_compiler() -> None:
    """Let pyzeros compile its attachments, which it does once per environment, in some 10 s; skip if it cannot."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CFLAGS", "-O0")
        try:
            PyzerosAttachment().serialize()
        except Exception as error:  # Cython and setuptools raise errors of many types
            pytest.skip(f"pyzeros cannot compile its messages: {error}")


class PyzerosPublisher:
    """A publisher of pyzeros that takes our messages."""

    def __init__(self, node: Node, topic: str, type_name: str, qos: Qos) -> None:
        profile = QosProfile(depth=qos.depth, reliability=int(qos.reliability))
        self._type = pyzeros_type(type_name)
        self._publisher = pyzeros.Pub(self._type, topic, profile, session=node, scope=None)
        self._repeats = qos.is_transient_local
        self._last: Any = None
        self._sent_s = 0.0

    def publish(self, message: Any, now_ns: int) -> None:
        """Convert a message, and send it."""
        del now_ns
        self._last, self._sent_s = to_pyzeros(self._type, message), time.monotonic()
        self._publisher.publish(self._last)

    def repeat(self) -> None:
        """Send the last message again if late nodes need it."""
        if self._repeats and self._last is not None and time.monotonic() - self._sent_s > REPEAT_S:
            self._sent_s = time.monotonic()
            self._publisher.publish(self._last)

    def close(self) -> None:
        """Withdraw the publisher."""
        self._publisher.close()


class PyzerosNode:
    """A node of pyzeros in the form of `protocol.ros2.node.Ros2Node`, as far as `RosRobot` uses it, without actions."""

    def __init__(self, router: str, namespace: str) -> None:
        self.messages = Messages("jazzy")
        self.namespace = f"/{namespace}"
        self._session = open_client(router)
        self._node = Node("pyzeros_robot", self._session, domain_id=0, namespace=self.namespace)
        self._publishers: list[PyzerosPublisher] = []
        self._subscriptions: list[RawSub] = []
        self._arrived: deque[tuple[Callable[[Any, Any], None], Any, bytes]] = deque()

    @property
    def token(self) -> PyzerosNode:
        """What has the namespace of the node."""
        return self

    def publisher(self, topic: str, type_name: str, qos: Qos = Qos()) -> PyzerosPublisher:  # noqa: B008  frozen
        """Declare a publisher."""
        self._publishers.append(PyzerosPublisher(self._node, topic, type_name, qos))
        return self._publishers[-1]

    def subscription(
        self, topic: str, type_name: str, qos: Qos, on_message: Callable[[Any, Any], None]
    ) -> None:
        """Declare a subscription; `spin` hands its messages, as pyzeros decodes them, to `on_message`."""
        kind = pyzeros_type(type_name)

        def take(sample: Any) -> None:
            self._arrived.append((on_message, kind, sample.payload.to_bytes()))

        self._subscriptions.append(
            RawSub(kind, topic, take, QosProfile(depth=qos.depth), session=self._node, scope=None)
        )

    def action_server(self, *arguments: object) -> None:
        """Offer no action: the robot is driven through topics."""

    def spin(self, now_ns: int) -> None:
        """Handle what has arrived, and send again what late nodes need."""
        del now_ns
        while self._arrived:
            on_message, kind, payload = self._arrived.popleft()
            on_message(kind.deserialize(payload), None)
        for each in self._publishers:
            each.repeat()

    def close(self) -> None:
        """Withdraw everything."""
        for each in (*self._subscriptions, *self._publishers, self._node):
            each.close()
        self._session.close()


class PyzerosSwarm:
    """The robots of a plan, r0, r1, and so on, on a thread of their own, by the wall clock."""

    def __init__(self, router: str, plan: Plan, rate: float = 10.0) -> None:
        self.swarm = Swarm(plan, time.time_ns(), rate=rate)
        self.ignored: list[str] = []
        """Messages that robots did not understand."""
        self._loop = asyncio.new_event_loop()
        asyncio.set_event_loop(self._loop)  # publishers need one, and earlier tests may have closed theirs
        self._nodes = [PyzerosNode(router, f"r{number}") for number in range(len(self.swarm.robots))]
        least = plan.scenario.laser.min_range_m
        self._robots = [
            RosRobot(node, robot, least, self.ignored.append, time.time_ns())  # type: ignore[arg-type]
            for node, robot in zip(self._nodes, self.swarm.robots, strict=True)
        ]
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._live, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread, and the nodes."""
        self._over.set()
        self._thread.join(10)
        for each in self._nodes:
            each.close()
        asyncio.set_event_loop(None)
        self._loop.close()

    def _live(self) -> None:
        swarm = self.swarm
        while not self._over.wait(max(0, swarm.next_ns - time.time_ns()) / 10**9):
            now = time.time_ns()
            for each in self._robots:
                each.receive(now)
            if swarm.advance(now):
                for each in self._robots:
                    each.publish(swarm.now_ns, now)
