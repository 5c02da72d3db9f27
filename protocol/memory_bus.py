"""The bus within one process: queues, one a participant; and whose turn it is to read."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from functools import partial

from protocol import keys as names
from protocol.bus import BusClosed, Message
from protocol.keys import Keys


class _Inbox:
    """One participant's queue; `flag` is its bit among those who have mail."""

    __slots__ = ("flag", "here", "messages", "name")

    def __init__(self, name: str, flag: int) -> None:
        self.name = name
        self.messages: deque[Message] = deque()
        self.here = False
        self.flag = flag


class MemoryHub:
    """Where all ends of one run meet.

    Parameters
    ----------
    order : sequence of str, optional
        In which order participants take turns (`in_turn`); who is not in it comes behind, as they were first heard of.
    """

    def __init__(self, run: str, order: Sequence[str] = ()) -> None:
        self.keys = Keys(run)
        self.mail = 0
        """Who has mail: a bit each."""
        self._inboxes: dict[str, _Inbox] = {}
        self.owners: dict[str, _Inbox] = {}
        """Whose inbox each key belongs to, of those that were used."""
        self._names: list[str] = []
        for name in order:
            self._inbox(name)

    def join(self, name: str) -> MemoryBus:
        """Open the end of `name`; the relay is told, of those that were here before it as well."""
        inbox = self._inbox(name)
        if inbox.here:
            raise ValueError(f"{name} is on the bus already")
        present = [other for other, each in self._inboxes.items() if each.here]
        inbox.here = True
        for other in present if name == names.RELAY else [name]:
            self.deliver(self.keys.presence(other), b"1")
        return MemoryBus(self, inbox)

    def deliver(self, key: str, payload: bytes) -> None:
        """Put a message into the inbox that its key belongs to, if its owner is here."""
        inbox = self.owners.get(key) or self._owner(key)
        if inbox.here:
            inbox.messages.append(_message((key, payload)))
            self.mail |= inbox.flag

    def leave(self, name: str) -> None:
        """Close the end of `name` and tell the relay."""
        inbox = self._inboxes[name]
        if inbox.here:
            inbox.here = False
            inbox.messages.clear()
            self.mail &= ~inbox.flag
            if name != names.RELAY:
                self.deliver(self.keys.presence(name), b"0")

    def nothing_for(self, inbox: _Inbox) -> None:
        """Note that an inbox is empty; BusClosed when the relay has left."""
        self.mail &= ~inbox.flag
        if not self._inbox(names.RELAY).here:
            raise BusClosed(f"{inbox.name}: the relay has left")

    def in_turn(self) -> Iterator[str]:
        """Who has mail, one after the other and each once, by the order of turns.

        Who gets mail on the way is among them if its turn has not passed.
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
        """The inbox that a key belongs to."""
        _, direction, owner, _ = names.parts(key)
        inbox = self.owners[key] = self._inbox(names.RELAY if direction == "tx" else owner)
        return inbox


class MemoryBus:
    """One participant's end of a `MemoryHub`. It never waits: if there is no message, others get their turn."""

    def __init__(self, hub: MemoryHub, inbox: _Inbox) -> None:
        self._hub = hub
        self._inbox = inbox
        self._messages = inbox.messages
        self._closed = False

    def put(self, key: str, payload: bytes) -> None:
        """Send `payload` to the owner of `key`."""
        if self._closed:
            raise self._refusal()
        hub = self._hub
        inbox = hub.owners.get(key)
        if inbox is None:
            hub.deliver(key, payload)
        elif inbox.here:
            if not inbox.messages:
                hub.mail |= inbox.flag
            inbox.messages.append(_message((key, payload)))

    def receive(self, timeout_s: float | None = None) -> Message | None:  # noqa: ARG002
        """Return the next message, or None when there is none now."""
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


_message = partial(tuple.__new__, Message)
"""A message of a key and a payload: a named tuple's own way takes twice as long."""
