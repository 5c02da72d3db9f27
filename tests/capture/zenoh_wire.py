"""Zenoh's framing on TCP, parsed far enough to extract keys and payloads.

A stream is batches, each behind its length (u16, little-endian). A batch is transport messages; of these, a
frame holds network messages and a fragment a piece of one. Of network messages, a declaration may give a key
expression a number, and a push carries a payload under a key, which is such a number, a text, or both. What
is not known here raises, so that nothing passes unread (Zenoh protocol 9, zenoh-protocol's headers).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

INIT, OPEN, CLOSE, KEEP_ALIVE, FRAME, FRAGMENT = range(1, 7)
INTEREST, PUSH, DECLARE, NETWORK_OAM = 0x19, 0x1D, 0x1E, 0x1F
PUT, DELETE = 0x01, 0x02
(
    DECLARE_KEY, UNDECLARE_KEY, DECLARE_SUBSCRIBER, UNDECLARE_SUBSCRIBER, DECLARE_QUERYABLE,
    UNDECLARE_QUERYABLE, DECLARE_TOKEN, UNDECLARE_TOKEN,
) = range(8)  # fmt: skip
DECLARE_FINAL = 0x1A

F5, F6, EXTENDED = 1 << 5, 1 << 6, 1 << 7
MORE = F6
QOS = 1
"""The extension with the priority of a frame or fragment."""


@dataclass(frozen=True)
class Message:
    """A message from one end to the other: kind (``put``, ``token`` or ``subscriber``), key, payload."""

    kind: str
    key: str
    payload: bytes = b""


class WireError(ValueError):
    """Bytes that this reader does not understand."""


@dataclass
class _Way:
    """One direction of a session."""

    pending: bytes = b""
    keys: dict[int, str] = field(default_factory=dict)
    fragments: dict[tuple[int, int], bytes] = field(default_factory=dict)
    batches: int = 0
    fragmented: int = 0


class Session:
    """Both directions of one TCP connection; feed them in the order in which the bytes came."""

    def __init__(self) -> None:
        self.ways = (_Way(), _Way())

    def feed(self, way: int, data: bytes) -> Iterator[Message]:
        """Take the next bytes of direction 0 or 1; yield the messages that they complete."""
        here = self.ways[way]
        here.pending += data
        while len(here.pending) >= 2:
            size = int.from_bytes(here.pending[:2], "little")
            if len(here.pending) < 2 + size:
                return
            batch, here.pending = here.pending[2 : 2 + size], here.pending[2 + size :]
            here.batches += 1
            yield from self._batch(way, batch)

    @property
    def pending(self) -> int:
        """Bytes of unfinished batches and fragments."""
        return sum(len(way.pending) + sum(map(len, way.fragments.values())) for way in self.ways)

    @property
    def fragmented(self) -> int:
        """Messages that came in fragments."""
        return sum(way.fragmented for way in self.ways)

    def _batch(self, way: int, batch: bytes) -> Iterator[Message]:
        reader = _Reader(batch)
        while reader.left:
            header = reader.byte()
            kind = header & 0x1F
            if kind in (INIT, OPEN):
                return  # the handshake: a batch of its own, before all else
            if kind == KEEP_ALIVE:
                reader.extensions(header)
            elif kind == CLOSE:
                reader.byte()
                reader.extensions(header)
            elif kind == FRAME:
                reader.number()
                reader.extensions(header)
                while reader.left and reader.peek() & 0x1F >= INTEREST:
                    yield from self._network(way, reader)
            elif kind == FRAGMENT:
                yield from self._fragment(way, header, reader)
            else:
                raise WireError(f"transport message {kind:#x} at {reader.at - 1} of {batch[:80].hex()}")

    def _fragment(self, way: int, header: int, reader: _Reader) -> Iterator[Message]:
        reader.number()
        priority = reader.extensions(header).get(QOS, 0) & 0x7
        pieces = self.ways[way].fragments
        stream = (priority, header & F5)
        whole = pieces.pop(stream, b"") + reader.rest()
        if header & MORE:
            pieces[stream] = whole
            return
        self.ways[way].fragmented += 1
        inner = _Reader(whole)
        yield from self._network(way, inner)
        if inner.left:
            raise WireError(f"{inner.left} bytes behind a message in fragments")

    def _network(self, way: int, reader: _Reader) -> Iterator[Message]:
        header = reader.byte()
        kind = header & 0x1F
        if kind == PUSH:
            key = self._key(way, header, reader)
            reader.extensions(header)
            yield from self._push(key, reader)
        elif kind == DECLARE:
            if header & F5:
                reader.number()
            reader.extensions(header)
            yield from self._declaration(way, reader)
        elif kind == INTEREST:
            reader.number()
            if header & (F5 | F6):
                options = reader.byte()
                if options & 0x10:
                    self._key(way, (options & F5) | (options & F6), reader)
            reader.extensions(header)
        elif kind == NETWORK_OAM:
            reader.number()
            reader.extensions(header)
            reader.body(header >> 5 & 3)
        else:
            raise WireError(f"network message {kind:#x} at {reader.at - 1} of {reader.data[:80].hex()}")

    def _push(self, key: str, reader: _Reader) -> Iterator[Message]:
        header = reader.byte()
        if header & 0x1F == DELETE:
            if header & F5:
                reader.timestamp()
            reader.extensions(header)
            yield Message("delete", key)
            return
        if header & 0x1F != PUT:
            raise WireError(f"push of {header:#x}")
        if header & F5:
            reader.timestamp()
        if header & F6 and reader.number() & 1:
            reader.block()
        reader.extensions(header)
        yield Message("put", key, reader.block())

    def _declaration(self, way: int, reader: _Reader) -> Iterator[Message]:
        header = reader.byte()
        kind = header & 0x1F
        if kind == DECLARE_FINAL:
            reader.extensions(header)
            return
        number = reader.number()
        if kind == DECLARE_KEY:
            scope = reader.number()
            suffix = reader.block().decode() if header & F5 else ""
            self.ways[way].keys[number] = self.ways[way].keys[scope] + suffix if scope else suffix
        elif kind in (DECLARE_SUBSCRIBER, DECLARE_QUERYABLE, DECLARE_TOKEN):
            key = self._key(way, header, reader)
            name = {DECLARE_SUBSCRIBER: "subscriber", DECLARE_TOKEN: "token"}.get(kind, "queryable")
            yield Message(name, key)
        elif kind not in (UNDECLARE_KEY, UNDECLARE_SUBSCRIBER, UNDECLARE_QUERYABLE, UNDECLARE_TOKEN):
            raise WireError(f"declaration {kind:#x}")
        reader.extensions(header)

    def _key(self, way: int, header: int, reader: _Reader) -> str:
        """A key: a number that sender (or else receiver) declared, and a text; either may be missing."""
        scope = reader.number()
        suffix = reader.block().decode() if header & F5 else ""
        known = self.ways[way if header & F6 else 1 - way].keys
        return known[scope] + suffix if scope else suffix


class _Reader:
    """Reads zenoh's numbers, byte strings and extensions."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.at = 0

    @property
    def left(self) -> int:
        return len(self.data) - self.at

    def peek(self) -> int:
        return self.data[self.at]

    def byte(self) -> int:
        return self._take(1)[0]

    def number(self) -> int:
        """A number in groups of seven bits, the lowest first; a ninth byte has eight."""
        value = 0
        for place in range(9):
            byte = self.byte()
            value |= (byte if place == 8 else byte & 0x7F) << (7 * place)
            if byte < 0x80:
                break
        return value

    def block(self) -> bytes:
        return self._take(self.number())

    def rest(self) -> bytes:
        return self._take(self.left)

    def timestamp(self) -> None:
        self.number()
        self.block()

    def body(self, encoding: int) -> int:
        """What an extension or an unknown message holds: nothing, a number or bytes."""
        if encoding == 1:
            return self.number()
        if encoding == 2:
            self.block()
        elif encoding:
            raise WireError(f"encoding {encoding}")
        return 0

    def extensions(self, header: int) -> dict[int, int]:
        """Read the extensions that a header announces; return the numbers among them."""
        found: dict[int, int] = {}
        more = bool(header & EXTENDED)
        while more:
            extension = self.byte()
            found[extension & 0x0F] = self.body(extension >> 5 & 3)
            more = bool(extension & EXTENDED)
        return found

    def _take(self, size: int) -> bytes:
        if size > self.left:
            raise WireError(f"{size} bytes wanted, {self.left} left, at {self.at} of {self.data[:80].hex()}")
        taken = self.data[self.at : self.at + size]
        self.at += size
        return taken
