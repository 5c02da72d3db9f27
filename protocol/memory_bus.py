"""The bus within one process: one queue per participant, and the order in which participants read them."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence

from protocol import keys as names
from protocol.bus import BusClosed, Message
from protocol.keys import Keys


class _Inbox:
    """Queue of one participant; `flag` is its bit in `MemoryHub.mail`."""

    __slots__ = ("flag", "here", "messages", "name")

    def __init__(self, name: str, flag: int) -> None:
        self.name = name
        self.messages: deque[Message] = deque()
        self.here = False
        self.flag = flag


class MemoryHub:
    """The queues of all participants of one run.

    Parameters
    ----------
    order : sequence of str, optional
        Names of participants in the order in which `in_turn` yields them; other participants follow in the order in
        which their names are first used.
    """

    def __init__(self, run: str, order: Sequence[str] = ()) -> None:
        self.keys = Keys(run)
        self.mail = 0
        """Bit mask of the participants whose queue is not empty."""
        self._inboxes: dict[str, _Inbox] = {}
        self._owners: dict[str, _Inbox] = {}
        """The inbox of each key that has been used."""
        self._names: list[str] = []
        for name in order:
            self._inbox(name)

    def join(self, name: str) -> MemoryBus:
        """Open the end of `name` and report it to the relay; the relay receives one for each earlier participant."""
        inbox = self._inbox(name)
        if inbox.here:
            raise ValueError(f"{name} is already on the bus")
        present = [other for other, each in self._inboxes.items() if each.here]
        inbox.here = True
        for other in present if name == names.RELAY else [name]:
            self.deliver(self.keys.presence(other), b"1")
        return MemoryBus(self, inbox)

    def deliver(self, key: str, payload: bytes) -> None:
        """Append a message to the inbox of its key, if its owner has joined."""
        inbox = self._owners.get(key) or self._owner(key)
        if inbox.here:
            inbox.messages.append(Message(key, payload))
            self.mail |= inbox.flag

    def leave(self, name: str) -> None:
        """Close the end of `name` and report it to the relay."""
        inbox = self._inboxes[name]
        if inbox.here:
            inbox.here = False
            inbox.messages.clear()
            self.mail &= ~inbox.flag
            if name != names.RELAY:
                self.deliver(self.keys.presence(name), b"0")

    def nothing_for(self, inbox: _Inbox) -> None:
        """Mark an inbox as empty; BusClosed if the relay has left."""
        self.mail &= ~inbox.flag
        if not self._inbox(names.RELAY).here:
            raise BusClosed(f"{inbox.name}: the relay has left")

    def in_turn(self) -> Iterator[str]:
        """Yield each participant with messages once, in the order of turns.

        A participant that gets its first message meanwhile is included, unless its turn has passed.
        """
        turn = 0
        while waiting := self.mail >> turn:
            turn += (waiting & -waiting).bit_length()
            yield self._names[turn - 1]

    def _inbox(self, name: str) -> _Inbox:
        inbox = self._inboxes.get(name)
        if inbox is None:
            inbox = self._inboxes[name] = _Inbox(name, 1 << len(self._names))
            self._names.append(name)
        return inbox

    def _owner(self, key: str) -> _Inbox:
        """Return the inbox of a key."""
        _, direction, owner, _ = names.parts(key)
        inbox = self._owners[key] = self._inbox(names.RELAY if direction == "tx" else owner)
        return inbox


class MemoryBus:
    """One participant's end of a `MemoryHub`. It never waits, because all participants share one thread."""

    def __init__(self, hub: MemoryHub, inbox: _Inbox) -> None:
        self._hub = hub
        self._inbox = inbox
        self._messages = inbox.messages
        self._closed = False

    def put(self, key: str, payload: bytes) -> None:
        """Send `payload` to the owner of `key`."""
        if self._closed:
            raise self._refusal()
        self._hub.deliver(key, payload)

    def receive(self, timeout_s: float | None = None) -> Message | None:  # noqa: ARG002
        """Return the next message, or None if there is none."""
        if self._messages:
            return self._messages.popleft()
        if self._closed:
            raise self._refusal()
        self._hub.nothing_for(self._inbox)
        return None

    def close(self) -> None:
        """Leave the bus."""
        if not self._closed:
            self._closed = True
            self._hub.leave(self._inbox.name)

    def _refusal(self) -> BusClosed:
        return BusClosed(f"{self._inbox.name}: this end of the bus is closed")
