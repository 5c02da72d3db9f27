"""The bus within one process: one queue per participant."""

from __future__ import annotations

from collections import deque

from protocol import keys as names
from protocol.bus import BusClosed, Message
from protocol.keys import Keys


class MemoryHub:
    """The hub that connects all ends of one run."""

    def __init__(self, run: str) -> None:
        self.keys = Keys(run)
        self._inboxes: dict[str, deque[Message]] = {}

    def join(self, name: str) -> MemoryBus:
        """Open the end of `name`; the relay is notified, also of those that joined before it."""
        if name in self._inboxes:
            raise ValueError(f"{name} is on the bus already")
        present = list(self._inboxes)
        self._inboxes[name] = deque()
        for other in present if name == names.RELAY else [name]:
            self.deliver(self.keys.presence(other), b"1")
        return MemoryBus(self, name)

    def deliver(self, key: str, payload: bytes) -> None:
        """Put a message into the inbox that its key belongs to, if its owner is present."""
        _, direction, owner, _ = names.parts(key)
        inbox = self._inboxes.get(names.RELAY if direction == "tx" else owner)
        if inbox is not None:
            inbox.append(Message(key, payload))

    def leave(self, name: str) -> None:
        """Close the end of `name` and tell the relay."""
        if self._inboxes.pop(name, None) is not None and name != names.RELAY:
            self.deliver(self.keys.presence(name), b"0")

    def next_for(self, name: str) -> Message | None:
        """The next message for `name`; BusClosed when there is none and the relay has left."""
        if self._inboxes[name]:
            return self._inboxes[name].popleft()
        if names.RELAY not in self._inboxes:
            raise BusClosed(f"{name}: the relay has left")
        return None


class MemoryBus:
    """One participant's end of a `MemoryHub`. It never waits: if there is no message, others get their turn."""

    def __init__(self, hub: MemoryHub, name: str) -> None:
        self._hub = hub
        self._name = name
        self._closed = False

    def put(self, key: str, payload: bytes) -> None:
        """Send `payload` to the owner of `key`."""
        self._check_open()
        self._hub.deliver(key, payload)

    def receive(self, timeout_s: float | None = None) -> Message | None:  # noqa: ARG002
        """Return the next message, or None when there is none now."""
        self._check_open()
        return self._hub.next_for(self._name)

    def close(self) -> None:
        """Leave the bus."""
        if not self._closed:
            self._closed = True
            self._hub.leave(self._name)

    def _check_open(self) -> None:
        if self._closed:
            raise BusClosed(f"{self._name}: this end of the bus is closed")
