"""Transport over UDP: one datagram per frame, to a multicast group or the broadcast address of one interface.

The socket is bound to the interface, so it neither sends nor receives anywhere else, and to the group's address, so it
receives no other traffic to that port. Datagrams have a time to live of 1: no router forwards them. Several robots of
one host receive each other; the echo of a robot's own frame is removed.
"""

from __future__ import annotations

import ipaddress
import socket
import struct
from collections import deque

from agent.radios.transport import MAX_PER_CALL, TransportError

GROUP = "239.77.85.82"
"""The default group, administratively scoped (RFC 2365)."""
PORT = 7785

MAX_DATAGRAM = 1400
"""Bytes of the longest frame: no link of an MTU of 1500 bytes, tunnels included, fragments it."""

_ECHOES = 32
"""Frames whose echo may still arrive."""

_BIND_TO_DEVICE = getattr(socket, "SO_BINDTODEVICE", None)


class UdpRadio:
    """UDP on one interface, for example ``wlan0``, with frames of up to `longest` bytes.

    `address` is a multicast group (IPv4), or the broadcast address of the interface's network. TransportError: there is
    no such interface, or no such address on it, or this process may not use it.
    """

    def __init__(
        self, interface: str, address: str = GROUP, port: int = PORT, longest: int = MAX_DATAGRAM
    ) -> None:
        self._longest = min(longest, MAX_DATAGRAM)
        self._destination = address, port
        self._sent: deque[bytes] = deque(maxlen=_ECHOES)
        try:
            number = socket.if_nametoindex(interface)
        except (OSError, ValueError):
            known = ", ".join(name for _, name in socket.if_nameindex())
            raise TransportError(f"interface {interface!r} does not exist; there are: {known}") from None
        try:
            group = ipaddress.IPv4Address(address)
        except ValueError:
            raise TransportError(f"address {address!r} is no IPv4 address, as {GROUP}") from None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        try:
            self._configure(interface, number, group)
        except OSError as error:
            self._socket.close()
            reason = f"{address}, port {port}, on interface {interface}: {error.strerror}"
            raise TransportError(f"{reason}; is the interface up, with an IPv4 address?") from None

    def send(self, frame: bytes) -> bool:
        """Send a frame; return False if it is too long, or the interface is down."""
        if len(frame) > self._longest:
            return False
        try:
            self._socket.sendto(frame, self._destination)
        except OSError:
            return False
        self._sent.append(frame)
        return True

    def receive(self) -> list[bytes]:
        """Return the frames that have arrived."""
        frames: list[bytes] = []
        for _ in range(MAX_PER_CALL):
            try:
                frame = self._socket.recv(self._longest + 1)
            except OSError:  # nothing is left, or the interface is down
                break
            if frame in self._sent:
                self._sent.remove(frame)
            else:
                frames.append(frame)
        return frames

    def fileno(self) -> int:
        """Return the file descriptor of the socket; -1 after `close`."""
        return self._socket.fileno()

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _configure(self, interface: str, number: int, group: ipaddress.IPv4Address) -> None:
        """Bind to interface and address; join the group, or allow broadcasts."""
        own = self._socket
        own.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if _BIND_TO_DEVICE is not None:
            own.setsockopt(socket.SOL_SOCKET, _BIND_TO_DEVICE, interface.encode() + b"\0")
        own.setsockopt(socket.IPPROTO_IP, socket.IP_TTL, 1)
        if group.is_multicast:
            member = struct.pack("4s4si", group.packed, bytes(4), number)
            own.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
            own.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, member)
            own.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 1)
            own.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 1)
        else:
            own.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        own.bind((str(group), self._destination[1]))
