"""Where the processes of a run meet: the hub's address, and what each of them shows there. Made anew for each run."""

from __future__ import annotations

import secrets
import socket
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from ipaddress import ip_address

from deploy.scenario.scenario import ScenarioError
from netshaper import access
from protocol import keys as names
from protocol.zenoh_bus import Certificate, Credential

LOOPBACK = "127.0.0.1"


@dataclass(frozen=True)
class Rendezvous:
    """A run's name, where its hub listens, and all credentials.

    Attributes
    ----------
    certificate : Certificate or None
        What the hub shows; None where it asks for passwords, on the loopback.
    """

    run: str
    endpoint: str
    credentials: Mapping[str, Credential]
    certificate: Certificate | None = None


def on_loopback(robots: int) -> Rendezvous:
    """A meeting at a free port of the loopback, by passwords."""
    run, endpoint = secrets.token_hex(4), f"tcp/{LOOPBACK}:{free_port(LOOPBACK)}"
    return Rendezvous(run, endpoint, access.issue(run, endpoint, robots))


def behind(router: Credential) -> Rendezvous:
    """Where the robots of a router meet: at a free port of the loopback, by passwords that nobody else knows."""
    endpoint = f"tcp/{LOOPBACK}:{free_port(LOOPBACK)}"
    return Rendezvous(router.run, endpoint, access.passwords(router.run, endpoint, router.robots))


def by_certificates(
    address: str, port: int | None, robots: int, routers: Mapping[str, Sequence[str]] | None = None
) -> Rendezvous:
    """A meeting at an address of this host that others can reach, by certificates made for this run alone.

    `routers` has the names of the robots that join through each router, by its name.

    Raises
    ------
    ScenarioError
        The address is not one of this host, or the port is taken.
    """
    from netshaper import certificates  # noqa: PLC0415  not needed on the loopback

    try:
        port = free_port(address, port or 0)
    except OSError as error:
        where = f"address = {address!r}" + (f", port = {port}" if port else "")
        raise ScenarioError(
            f"{where}: the hub cannot listen there: {error.strerror}; "
            "it must be the address by which the other hosts know this one, and a port that is free"
        ) from None
    run, endpoint = secrets.token_hex(4), f"tls/{_bracketed(address)}:{port}"
    made = certificates.make(robots, [address], routers=routers)
    return Rendezvous(run, endpoint, certificates.credentials(run, endpoint, made), made[names.RELAY])


def free_port(address: str, port: int = 0) -> int:
    """A port that nobody listens to now: `port`, if that is not 0; OSError if it is taken."""
    family, kind, number, _, place = socket.getaddrinfo(address, port, type=socket.SOCK_STREAM)[0]
    with socket.socket(family, kind, number) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind(place)
        found: int = probe.getsockname()[1]
        return found


def _bracketed(address: str) -> str:
    """An address as it stands before a port."""
    try:
        return f"[{address}]" if ip_address(address).version == 6 else address
    except ValueError:
        return address  # a name
