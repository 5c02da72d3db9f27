"""What all endpoints of a node share: its session, its liveliness tokens, and an inbox that the main loop reads.

Zenoh calls back on threads of its own, and hides exceptions there. So an arriving message only enters the inbox of its
endpoint; `Ros2Node.spin` decodes it on the caller's thread. An inbox keeps the last messages, as many as the depth of
the quality of service.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from itertools import count
from typing import Any

import zenoh

from protocol.errors import ProtocolError
from protocol.ros2.messages import Messages
from protocol.ros2.names import DataKey, qualified
from protocol.ros2.qos import Qos
from protocol.ros2.tokens import EndpointToken, Kind, NodeToken, gid


class Link:
    """A node's connection: its session, token, and messages, and the event that wakes its main loop."""

    def __init__(self, session: zenoh.Session, node: NodeToken, messages: Messages) -> None:
        self.session = session
        self.node = node
        self.messages = messages
        self.wake = threading.Event()
        self._ids = count(node.node_id + 1)

    def token(self, kind: Kind, name: str, type_name: str, qos: Qos) -> EndpointToken:
        """Return the token of a new endpoint; ValueError for a wrong name or unknown type."""
        full = qualified(name, self.node.namespace, self.node.name)
        key = DataKey(self.node.domain, full, type_name, self.messages.type_hash(type_name))
        return EndpointToken(self.node, next(self._ids), kind, key, qos)


class Endpoint:
    """An endpoint with its declarations; they are taken back in reverse order, the liveliness token first."""

    def __init__(self, link: Link, token: EndpointToken) -> None:
        self.link = link
        self.token = token
        self.key = str(token.data_key)
        self.gid = gid(str(token))
        self._declared: list[Any] = []

    @property
    def name(self) -> str:
        """Qualified name of its topic or service."""
        return self.token.data_key.name

    def announce(self, declared: Any) -> None:
        """Keep a declaration of Zenoh, and declare the liveliness token: other nodes now see the endpoint."""
        liveliness = self.link.session.liveliness().declare_token(str(self.token))
        self._declared = [declared, liveliness]

    def close(self) -> None:
        """Withdraw the endpoint."""
        while self._declared:
            self._declared.pop().undeclare()


class Receiver(Endpoint, ABC):
    """An endpoint with an inbox of at most `most` items, None for no limit; a new item replaces the oldest one.

    `handle` is called with each decoded item, and the time in nanoseconds since 1970.
    """

    def __init__(
        self, link: Link, token: EndpointToken, most: int | None, handle: Callable[[Any, int], object]
    ) -> None:
        super().__init__(link, token)
        self._handle = handle
        self.rejected = 0
        """Number of malformed messages."""
        self.last_error = ""
        """What was wrong with the last of them."""
        self.inbox: deque[Any] = deque(maxlen=most)

    def put(self, item: Any) -> None:
        """Add an item, on a thread of Zenoh."""
        self.inbox.append(item)
        self.link.wake.set()

    def take(self, now_ns: int) -> int:
        """Decode and handle all items of the inbox; return how many."""
        taken = len(self.inbox)
        for _ in range(taken):
            try:
                decoded = self.decode(self.inbox.popleft())
            except ProtocolError as error:
                self.rejected += 1
                self.last_error = f"{self.name}: {error}"
            else:
                self._handle(decoded, now_ns)
        return taken

    @abstractmethod
    def decode(self, item: Any) -> Any:
        """Decode an item of the inbox; ProtocolError if it is malformed."""


def content(part: zenoh.ZBytes | None) -> bytes | None:
    """Return the bytes of a payload or attachment."""
    return None if part is None else part.to_bytes()
