"""The bus within one process: one queue per participant, and the order in which participants read them."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence

from protocol import keys as names
from protocol.bus import BusClosed, Message
from protocol.keys import Keys


class MemoryHub:
    """The queues of all participants of one run.

    `order` has names of participants in the order in which `in_turn` yields them; other participants follow in the
    order in which their names are first used.
    """

    def __init__(self, run: str, order: Sequence[str] = ()) -> None:
        self.keys = Keys(run)
        self.mail = 0
        """Bit mask of the participants whose queue is not empty."""
        self._ends: dict[str, MemoryBus] = {}
        self._owners: dict[str, MemoryBus] = {}
        """The receiver of each key that has been used."""
        self._names: list[str] = []
        for name in order:
            self.end(name)

    def join(self, name: str) -> MemoryBus:
        """Open the end of `name` and report it to the relay; the relay receives one for each earlier participant."""
        end = self.end(name)
        if end.here:
            raise ValueError(f"{name} is already on the bus")
        present = [other for other, each in self._ends.items() if each.here]
        end.here = True
        for other in present if name == names.RELAY else [name]:
            self.deliver(self.keys.presence(other), b"1")
        return end

    def deliver(self, key: str, payload: bytes) -> None:
        """Append a message to the queue of its key's owner, if that has joined."""
        end = self._owners.get(key) or self._owner(key)
        if end.here:
            end.messages.append(Message(key, payload))
            self.mail |= end.flag

    def in_turn(self) -> Iterator[str]:
        """Yield each participant with messages once, in the order of turns.

        A participant that gets its first message meanwhile is included, unless its turn has passed.
        """
        turn = 0
        while waiting := self.mail >> turn:
            turn += (waiting & -waiting).bit_length()
            yield self._names[turn - 1]

    def end(self, name: str) -> MemoryBus:
        """Return the end of `name`, which is closed until it joins."""
        if name not in self._ends:
            self._ends[name] = MemoryBus(self, name, 1 << len(self._names))
            self._names.append(name)
        return self._ends[name]

    def _owner(self, key: str) -> MemoryBus:
        _, direction, owner, _ = names.parts(key)
        end = self._owners[key] = self.end(names.RELAY if direction == "tx" else owner)
        return end


class MemoryBus:
    """One participant's end of a `MemoryHub`. It never waits, because all participants share one thread."""

    def __init__(self, hub: MemoryHub, name: str, flag: int) -> None:
        self.name = name
        self.messages: deque[Message] = deque()
        """Messages that `receive` has not returned yet."""
        self.here = False
        """Whether it is open."""
        self.flag = flag
        """Its bit in `MemoryHub.mail`."""
        self._hub = hub

    def put(self, key: str, payload: bytes) -> None:
        """Send `payload` to the owner of `key`."""
        if not self.here:
            raise self._refusal()
        self._hub.deliver(key, payload)

    def receive(self, timeout_s: float | None = None) -> Message | None:  # noqa: ARG002
        """Return the next message, or None if there is none."""
        if self.messages:
            message = self.messages.popleft()
            if not self.messages:
                self._hub.mail &= ~self.flag
            return message
        if not self.here:
            raise self._refusal()
        if not self._hub.end(names.RELAY).here:
            raise BusClosed(f"{self.name}: the relay has left")
        return None

    def close(self) -> None:
        """Leave the bus, and report it to the relay."""
        if self.here:
            self.here = False
            self.messages.clear()
            self._hub.mail &= ~self.flag
            if self.name != names.RELAY:
                self._hub.deliver(self._hub.keys.presence(self.name), b"0")

    def _refusal(self) -> BusClosed:
        return BusClosed(f"{self.name}: this end of the bus is closed")
