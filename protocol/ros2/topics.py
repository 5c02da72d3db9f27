"""Publishers and subscriptions of a node.

With transient local durability, the publisher keeps its last messages, and a later subscription requests them: Zenoh's
advanced publisher and subscriber, with the settings of rmw_zenoh.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import zenoh
from zenoh import ext

from protocol.ros2.attachments import Attachment, decode_attachment
from protocol.ros2.endpoints import Endpoint, Link, Receiver, content
from protocol.ros2.qos import History, Qos, Reliability
from protocol.ros2.tokens import Kind

HEARTBEAT_S = 0.5
"""Interval at which a transient local publisher tells the number of its last message, if it has changed."""

OnMessage = Callable[[Any, Attachment], None]
"""Receives a message and its attachment."""


class Publisher(Endpoint):
    """A publisher on a topic."""

    def __init__(self, link: Link, name: str, type_name: str, qos: Qos) -> None:
        super().__init__(link, link.token(Kind.PUBLISHER, name, type_name, qos))
        self._type = type_name
        self._sequence = 0
        is_reliable = qos.reliability is Reliability.RELIABLE
        may_block = is_reliable and qos.history is History.KEEP_ALL
        congestion = zenoh.CongestionControl.BLOCK if may_block else zenoh.CongestionControl.DROP
        reliability = zenoh.Reliability.RELIABLE if is_reliable else zenoh.Reliability.BEST_EFFORT
        self._publisher: Any
        if qos.is_transient_local:
            heartbeat = ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=HEARTBEAT_S)
            self._publisher = ext.declare_advanced_publisher(
                link.session,
                self.key,
                congestion_control=congestion,
                reliability=reliability,
                cache=ext.CacheConfig(qos.depth),
                sample_miss_detection=heartbeat if is_reliable else None,
                publisher_detection=True,
            )
        else:
            self._publisher = link.session.declare_publisher(
                self.key, congestion_control=congestion, reliability=reliability
            )
        self.announce(self._publisher)

    def publish(self, message: Any, now_ns: int) -> None:
        """Send a message, at `now_ns` since 1970; ValueError if it is not one of the topic's type."""
        if message.__msgtype__ != self._type:
            raise ValueError(f"{self.name} has messages of type {self._type}, not {message.__msgtype__}")
        payload = self.link.messages.encode(message)
        self._sequence += 1
        attachment = Attachment(self._sequence, now_ns, self.gid)
        self._publisher.put(payload, attachment=attachment.encode())


class Subscription(Receiver):
    """A subscription to a topic."""

    def __init__(self, link: Link, name: str, type_name: str, qos: Qos, on_message: OnMessage) -> None:
        token = link.token(Kind.SUBSCRIPTION, name, type_name, qos)
        super().__init__(link, token, qos.kept, lambda decoded, _: on_message(*decoded))
        self._type = type_name
        self._subscriber: Any
        if qos.is_transient_local:
            is_reliable = qos.reliability is Reliability.RELIABLE
            self._subscriber = ext.declare_advanced_subscriber(
                link.session,
                self.key,
                self._arrive,
                history=ext.HistoryConfig(detect_late_publishers=True, max_samples=qos.depth),
                recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True) if is_reliable else None,
                subscriber_detection=True,
            )
        else:
            self._subscriber = link.session.declare_subscriber(self.key, self._arrive)
        self.announce(self._subscriber)

    def _arrive(self, sample: zenoh.Sample) -> None:
        self.put((sample.payload.to_bytes(), content(sample.attachment)))

    def decode(self, item: tuple[bytes, bytes | None]) -> tuple[Any, Attachment]:
        """Decode a message and its attachment."""
        payload, attachment = item
        source = decode_attachment(attachment)
        return self.link.messages.decode(payload, self._type), source
