"""The cost of the bus itself: bytes on the hub's TCP connections, as the kernel counts them.

Linux reports sockets over netlink (``sock_diag(7)``) without special rights; the hub's port selects its
connections. On other systems, or if the hub is on another host, the figure is not available. It is asked here rather
than through a library for netlink, because that brings an event loop, and a notebook runs one already.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator

LOOPBACKS = ("127.0.0.1", "[::1]")

_NETLINK_SOCK_DIAG, _SOCK_DIAG_BY_FAMILY = 4, 20
_REQUEST_DUMP = 0x301
_DONE, _ERROR = 3, 2
_INFO = 2
_STATES = 0xFFF
_HEADER = struct.Struct("<IHHII")
_ID = struct.Struct(">HH16s16s4s8s")
_PATIENCE_S = 1.0
_RECEIVE = 1 << 16
_MESSAGE = 72
"""Bytes of ``struct inet_diag_msg``, which the attributes follow."""
_ID_AT = 4
"""Where it has the socket's identity."""
_RECEIVED_AT, _SENT_AT = 128, 200
"""Where ``struct tcp_info`` has tcpi_bytes_received; tcpi_bytes_sent and _retrans (since Linux 4.19)."""


class Meter:
    """Counts the bytes of all connections to a hub on this host, including those that have ended.

    A connection counts up to the last `read` before its end, so read now and then.

    Parameters
    ----------
    endpoint : str
        Where the hub listens, as ``tcp/127.0.0.1:7447``.
    here : bool
        Whether that is known to be on this host; on the loopback it always is.
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
    """All TCP sockets of a family with such a local port: their identity, and the bytes that they moved."""
    wanted = struct.pack("<BBBxI", family, socket.IPPROTO_TCP, 1 << (_INFO - 1), _STATES)
    wanted += _ID.pack(port, 0, bytes(16), bytes(16), bytes(4), b"\xff" * 8)
    with socket.socket(socket.AF_NETLINK, socket.SOCK_DGRAM, _NETLINK_SOCK_DIAG) as kernel:
        kernel.settimeout(_PATIENCE_S)
        kernel.send(
            _HEADER.pack(_HEADER.size + len(wanted), _SOCK_DIAG_BY_FAMILY, _REQUEST_DUMP, 1, 0) + wanted
        )
        while True:
            data = kernel.recv(_RECEIVE)
            while data:
                size, kind, *_ = _HEADER.unpack_from(data)
                if kind == _DONE:
                    return
                if kind == _ERROR:
                    raise OSError("the kernel has no sock_diag")
                message = data[_HEADER.size : size]
                count = _count(message[_MESSAGE:])
                if count is not None:
                    yield message[_ID_AT : _ID_AT + _ID.size], count
                data = data[size + -size % 4 :]


def _count(attributes: bytes) -> int | None:
    """Bytes moved, as the attribute with ``struct tcp_info`` has them; None if there is none."""
    while len(attributes) >= 4:
        size, kind = struct.unpack_from("<HH", attributes)
        if kind == _INFO and size >= 4 + _SENT_AT + 16:
            (received,) = struct.unpack_from("<Q", attributes, 4 + _RECEIVED_AT)
            sent, sent_again = struct.unpack_from("<QQ", attributes, 4 + _SENT_AT)
            return int(received + sent - sent_again)
        attributes = attributes[size + -size % 4 :]
    return None
