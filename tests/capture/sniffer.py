"""All that crosses the loopback, taken by a raw socket: frames, and the TCP streams put together from them.

Linux only, and it needs the right to open raw sockets.
"""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

ETH_P_ALL, SOL_PACKET = 0x0003, 263
PACKET_STATISTICS, PACKET_IGNORE_OUTGOING = 6, 23
SO_RCVBUFFORCE = 33
BUFFER = 1 << 28
FRAME = 1 << 18
ETHERNET, IPV4, TCP = 14, 0x0800, 6
FIN, SYN = 1, 2
WINDOW = 1 << 32


class Sniffer:
    """Takes every packet of the loopback from its beginning to its end, or says how many it missed."""

    def __init__(self) -> None:
        self.packets: list[bytes] = []
        """Ethernet frames, in the order in which the kernel passed them on."""
        self.dropped = 0
        self._socket = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ETH_P_ALL))
        self._socket.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, BUFFER)
        self._socket.setsockopt(SOL_PACKET, PACKET_IGNORE_OUTGOING, 1)
        self._socket.bind(("lo", 0))
        self._socket.settimeout(0.2)
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._read, name="sniffer")

    def __enter__(self) -> Sniffer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join()
        _, self.dropped = struct.unpack("II", self._socket.getsockopt(SOL_PACKET, PACKET_STATISTICS, 8))
        self._socket.close()

    def _read(self) -> None:
        while True:
            try:
                self.packets.append(self._socket.recv(FRAME))
            except TimeoutError:
                if self._ending.is_set():
                    return


@dataclass(frozen=True)
class Segment:
    """One TCP segment; ports stand for the ends, for all is on 127.0.0.1."""

    source: int
    target: int
    sequence: int
    flags: int
    data: bytes


@dataclass
class Strangers:
    """What was no TCP over IPv4, counted by ethernet type and protocol."""

    counts: dict[str, int] = field(default_factory=dict)

    def add(self, what: str) -> None:
        self.counts[what] = self.counts.get(what, 0) + 1


def segments(packets: Iterable[bytes], strangers: Strangers) -> Iterator[Segment]:
    """Read the TCP segments out of ethernet frames."""
    for packet in packets:
        (kind,) = struct.unpack_from(">H", packet, 12)
        if kind != IPV4:
            strangers.add(f"ethernet type {kind:#06x}")
            continue
        if packet[ETHERNET + 9] != TCP:
            strangers.add(f"IP protocol {packet[ETHERNET + 9]}")
            continue
        (length,) = struct.unpack_from(">H", packet, ETHERNET + 2)
        start = ETHERNET + 4 * (packet[ETHERNET] & 0xF)
        source, target, sequence, _, offset, flags = struct.unpack_from(">HHIIBB", packet, start)
        yield Segment(source, target, sequence, flags, packet[start + 4 * (offset >> 4) : ETHERNET + length])


class Stream:
    """One direction of a TCP connection, put in order by its sequence numbers."""

    def __init__(self) -> None:
        self.bytes = 0
        """Bytes that came, each counted once."""
        self.complete = False
        """Whether it was seen to begin."""
        self._next = -1
        self._early: dict[int, bytes] = {}

    @property
    def missing(self) -> bool:
        """Whether bytes came whose forerunners never did."""
        return bool(self._early)

    def take(self, segment: Segment) -> bytes:
        """Take a segment; return the bytes that are next in order now."""
        if segment.flags & SYN:
            self._next = (segment.sequence + 1) % WINDOW
            self.complete = True
            return b""
        if self._next < 0:
            self._next = segment.sequence
        if segment.data:
            self._early.setdefault(segment.sequence, segment.data)
        ready = b""
        for sequence in sorted(self._early, key=lambda at: (at - self._next + WINDOW // 2) % WINDOW):
            known = (self._next - sequence + WINDOW // 2) % WINDOW - WINDOW // 2
            if known < 0:
                break
            fresh = self._early.pop(sequence)[known:]
            ready += fresh
            self._next = (self._next + len(fresh)) % WINDOW
        self.bytes += len(ready)
        return ready
