"""Transport over UDP: one datagram per frame, to a multicast group or the broadcast address of one interface.

The socket is bound to the interface, so it neither sends nor receives anywhere else, and to the group's address, so it
receives no other traffic to that port. Datagrams have a time to live of 1: no router forwards them. Several robots of
one host receive each other; the echo of a robot's own frame is removed.
"""

from __future__ import annotations

import contextlib
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
        self._interface = interface
        self._destination = address, port
        self._sent: deque[bytes] = deque(maxlen=_ECHOES)
        try:
            self._number = socket.if_nametoindex(interface)
        except (OSError, ValueError):
            known = ", ".join(name for _, name in socket.if_nameindex())
            raise TransportError(f"interface {interface!r} does not exist; there are: {known}") from None
        try:
            self._group = ipaddress.IPv4Address(address)
        except ValueError:
            raise TransportError(f"address {address!r} is no IPv4 address, as {GROUP}") from None
        try:
            self._socket = self._open(self._number)
        except OSError as error:
            reason = f"{address}, port {port}, on interface {interface}: {error.strerror}"
            raise TransportError(f"{reason}; is the interface up, with an IPv4 address?") from None

    def send(self, frame: bytes) -> bool:
        """Send a frame; return False if it is too long, or the interface is down."""
        if len(frame) > self._longest:
            return False
        try:
            self._socket.sendto(frame, self._destination)
        except OSError:
            self._return_to_interface()
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

    def _return_to_interface(self) -> None:
        """Open the socket anew if the interface has come back as another one, as a Wi-Fi stick that was plugged in."""
        with contextlib.suppress(OSError):  # it is still gone, or has no address yet
            number = socket.if_nametoindex(self._interface)
            if number != self._number:
                opened = self._open(number)
                self._socket.close()
                self._socket, self._number = opened, number

    def _open(self, number: int) -> socket.socket:
        """Return a new socket on the interface with this index; OSError if it, or the address, cannot be used."""
        with contextlib.ExitStack() as stack:
            own = socket.socket(socket.AF_INET, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
            stack.callback(own.close)
            self._configure(own, number)
            stack.pop_all()
        return own

    def _configure(self, own: socket.socket, number: int) -> None:
        """Bind to interface and address; join the group, or allow broadcasts."""
        own.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if _BIND_TO_DEVICE is not None:
            own.setsockopt(socket.SOL_SOCKET, _BIND_TO_DEVICE, self._interface.encode() + b"\0")
        own.setsockopt(socket.IPPROTO_IP, socket.IP_TTL, 1)
        if self._group.is_multicast:
            member = struct.pack("4s4si", self._group.packed, bytes(4), number)
            own.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
            own.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, member)
            own.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 1)
            own.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 1)
        else:
            own.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        own.bind(self._destination)
