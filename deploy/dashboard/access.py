"""Who may do what with the page of a run: checks of hosts, origins and tokens.

Everything that the page consists of requires a token: that to watch, or that to control. The address printed in the
terminal contains one. A browser sends the token to watch as a cookie, which only permits reading, and the token to
control in a header, which only the page itself can set: pages of other origins can neither read nor send it.
"""

from __future__ import annotations

import ipaddress
import secrets
import socket
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from urllib.parse import urlsplit

LOOPBACK = "127.0.0.1"
LOCAL_NAMES = (LOOPBACK, "localhost")
TOKEN_HEADER = "X-Murmur-Token"
_ELSEWHERE = "192.0.2.1"
"""An address that no host has (RFC 5737)."""


def _token() -> str:
    return secrets.token_urlsafe(16)


@dataclass(frozen=True)
class Access:
    """The rights to a page at an address; each page has new tokens of 128 random bits."""

    address: str = LOOPBACK
    watch: str = field(default_factory=_token)
    """The token to watch."""
    control: str = field(default_factory=_token)
    """The token to watch and to control the run."""

    @property
    def cookie(self) -> str:
        """Name of the cookie with the token to watch; cookies of all ports of a host are together."""
        return f"murmur-{self.watch[:6]}"

    def may_watch(self, token: str, cookies: str) -> bool:
        """Whether a request with this token, or these cookies, may read."""
        try:
            jar = SimpleCookie(cookies)
        except CookieError:
            jar = SimpleCookie()
        kept = jar[self.cookie].value if self.cookie in jar else ""
        return self.may_control(token) or any(_same(each, self.watch) for each in (token, kept))

    def may_control(self, token: str) -> bool:
        """Whether a request with this token may control the run."""
        return _same(token, self.control)

    def is_own_host(self, host: str) -> bool:
        """Whether a request's `Host` names this page's address, with any port: it may be forwarded.

        Another name would mean that a foreign page has pointed its own name here (DNS rebinding).
        """
        try:
            name = urlsplit(f"//{host}").hostname
        except ValueError:
            return False
        return name == self.address or (self.address == LOOPBACK and name in LOCAL_NAMES)

    @staticmethod
    def is_own_origin(origin: str, host: str) -> bool:
        """Whether a request comes from this page; browsers name the origin of all requests that are not mere reads."""
        return origin == f"http://{host}"


def _same(one: str, other: str) -> bool:
    return secrets.compare_digest(one.encode(), other.encode())


def local_network_address() -> str:
    """Return this computer's address on the local network.

    Raises ValueError if it has none, or a public one: the page is not encrypted.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((_ELSEWHERE, 9))  # sends nothing; chooses the interface
            address = str(probe.getsockname()[0])
        except OSError:
            raise ValueError("share: this computer is not on a network; omit --share") from None
    kind = ipaddress.ip_address(address)
    if kind.is_loopback or not kind.is_private:
        raise ValueError(
            f"share: {address} is not an address of a local network; forward the port with ssh -L instead"
        )
    return address
