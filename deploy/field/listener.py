"""Listens to a robot's ROS 2 nodes as its own node does, and notes what arrives on each topic; it sends nothing."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from agent.bodies.ros2 import Ros2Body
from deploy.field.connection import open_node, sources
from deploy.field.robot_file import Ros2Table
from protocol.ros2.messages import TRANSFORMS, nanoseconds
from protocol.ros2.names import qualified
from protocol.ros2.qos import Qos

LISTEN_S, ENOUGH_S = 6.0, 2.0
"""Longest time of listening in seconds, and the shortest, after which it ends once everything has arrived."""
ENOUGH_MESSAGES = 4
"""Messages of a topic from which its rate is measured."""


@dataclass
class ReceivedTopic:
    """The messages of a topic so far: when they arrived, in seconds, and their stamps in nanoseconds."""

    topic: str
    type_name: str
    arrived: list[float] = field(default_factory=list)
    stamps: list[int] = field(default_factory=list)
    frame: str = ""
    """Frame of the last message."""

    @property
    def rate(self) -> float:
        """Messages per second; 0 for fewer than two."""
        span = self.arrived[-1] - self.arrived[0] if len(self.arrived) > 1 else 0.0
        return (len(self.arrived) - 1) / span if span else 0.0


class Listener:
    """A node that subscribes to what a robot offers, and hands it to `body`; ConnectionError if no router answers."""

    def __init__(self, names: Ros2Table, body: Ros2Body) -> None:
        self.node = open_node(names, "_doctor")
        self.received: dict[str, ReceivedTopic] = {}
        """By name in the settings: tf_static, tf, map, scan."""
        self._names, self._body = names, body
        for source in sources(names, body):
            self._subscribe(*source)

    def qualified(self, name: str) -> str:
        """Return the full name of a topic or service."""
        return qualified(name, self.node.token.namespace, self.node.token.name)

    def listen(self) -> None:
        """Wait until enough messages of each topic have arrived, `LISTEN_S` at most."""
        begin = time.monotonic()
        while (waited := time.monotonic() - begin) < LISTEN_S:
            self.node.spin(time.time_ns(), 0.02)
            self._body.take_newest()
            if waited > ENOUGH_S and all(map(self._is_enough, self.received)) and not self._body.problem:
                break

    def _is_enough(self, name: str) -> bool:
        least = {"tf_static": 0, "map": 1}.get(name, ENOUGH_MESSAGES)
        return len(self.received[name].arrived) >= least

    def _subscribe(self, name: str, type_name: str, qos: Qos, take: Callable[[Any], None]) -> None:
        topic = getattr(self._names, name)
        received = self.received[name] = ReceivedTopic(self.qualified(topic), type_name)

        def note(message: Any, _: object) -> None:
            headers = (
                [each.header for each in message.transforms] if type_name == TRANSFORMS else [message.header]
            )
            received.arrived.append(time.monotonic())
            received.stamps += [nanoseconds(each.stamp) for each in headers]
            received.frame = headers[-1].frame_id if headers else received.frame
            take(message)

        self.node.subscription(topic, type_name, qos, note)
