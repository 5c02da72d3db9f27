"""The cost of the bus: bytes on the hub's TCP connections, as the kernel counts them.

Linux reports sockets over netlink (``sock_diag(7)``) without special rights; the hub's port selects its connections.
The count is not available on other systems, or if the hub is on another host. This module has no netlink library,
because such a library needs an event loop of its own, which conflicts with that of notebooks.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator

LOOPBACKS = ("127.0.0.1", "[::1]")

_NETLINK_SOCK_DIAG, _SOCK_DIAG_BY_FAMILY, _REQUEST_DUMP = 4, 20, 0x301
_DONE, _ERROR = 3, 2
"""Types of messages of the kernel."""
_INFO, _ALL_STATES = 2, 0xFFF
_HEADER = struct.Struct("<IHHII")
_REQUEST = struct.Struct("<BBBxI")
_ID = struct.Struct(">HH16s16s4s8s")
_ID_AT, _ATTRIBUTES_AT = 4, 72
"""Offsets of the socket's identity, and of the attributes, in ``struct inet_diag_msg``."""
_RECEIVED_AT, _SENT_AT = 128, 200
"""Offsets in ``struct tcp_info``: tcpi_bytes_received; tcpi_bytes_sent and _retrans (since Linux 4.19)."""


class Meter:
    """Counts the bytes of all connections to a hub on this host, including those that have ended.

    A connection counts up to the last `read` before its end, so the caller should read repeatedly.

    Parameters
    ----------
    endpoint : str
        The hub's address, as ``tcp/127.0.0.1:7447``.
    here : bool
        Whether the hub is on this host; on the loopback it always is.
    """

    def __init__(self, endpoint: str, *, here: bool = False) -> None:
        host, _, port = endpoint.partition("/")[2].rpartition(":")
        is_here = (here or host in LOOPBACKS) and hasattr(socket, "AF_NETLINK")
        self._port = int(port) if is_here else 0
        self._seen: dict[bytes, int] = {}

    def read(self) -> int | None:
        """Bytes so far in both directions, without TCP's own headers; None if not available."""
        if not self._port:
            return None
        try:
            for family in (socket.AF_INET, socket.AF_INET6):
                self._seen.update(_connections(self._port, family))
        except OSError:
            self._port = 0  # not supported by this kernel
            return None
        return sum(self._seen.values()) if self._seen else None


def _connections(port: int, family: int) -> Iterator[tuple[bytes, int]]:
    """The TCP sockets of a family with a local port: their identity, and the bytes that they moved."""
    wanted = _REQUEST.pack(family, socket.IPPROTO_TCP, 1 << (_INFO - 1), _ALL_STATES)
    wanted += _ID.pack(port, 0, bytes(16), bytes(16), bytes(4), b"\xff" * 8)
    head = _HEADER.pack(_HEADER.size + len(wanted), _SOCK_DIAG_BY_FAMILY, _REQUEST_DUMP, 1, 0)
    with socket.socket(socket.AF_NETLINK, socket.SOCK_DGRAM, _NETLINK_SOCK_DIAG) as kernel:
        kernel.settimeout(1.0)
        kernel.send(head + wanted)
        while True:
            data = kernel.recv(1 << 16)
            while data:
                size, kind, *_ = _HEADER.unpack_from(data)
                if kind == _DONE:
                    return
                if kind == _ERROR:
                    raise OSError("the kernel has no sock_diag")
                message, data = data[_HEADER.size : size], data[size + -size % 4 :]
                count = _count(message[_ATTRIBUTES_AT:])
                if count is not None:
                    yield message[_ID_AT : _ID_AT + _ID.size], count


def _count(attributes: bytes) -> int | None:
    """Bytes moved, from the attribute with ``struct tcp_info``; None without that attribute."""
    while len(attributes) >= 4:
        size, kind = struct.unpack_from("<HH", attributes)
        if kind == _INFO and size >= 4 + _SENT_AT + 16:
            (received,) = struct.unpack_from("<Q", attributes, 4 + _RECEIVED_AT)
            sent, retransmitted = struct.unpack_from("<QQ", attributes, 4 + _SENT_AT)
            return int(received + sent - retransmitted)
        attributes = attributes[size + -size % 4 :]
    return None
