"""The rendezvous of a run's processes: the hub's address and the credentials of all participants."""

from __future__ import annotations

import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from deploy.dashboard.access import LOOPBACK
from deploy.dashboard.windows import free_port
from deploy.scenario.errors import ScenarioError
from netshaper import access
from protocol import keys as names
from protocol.zenoh_bus import Certificate, Credential


@dataclass(frozen=True)
class Rendezvous:
    """A run's name, the address of its hub, and all credentials."""

    run: str
    endpoint: str
    credentials: Mapping[str, Credential]
    certificate: Certificate | None = None
    """The hub's certificate; None with passwords, on the loopback interface."""


def on_loopback(robots: int) -> Rendezvous:
    """Return a rendezvous at a free port of the loopback interface, with passwords."""
    run, endpoint = secrets.token_hex(4), f"tcp/{LOOPBACK}:{free_port()}"
    return Rendezvous(run, endpoint, access.issue(run, endpoint, robots))


def behind(router: Credential) -> Rendezvous:
    """Return the rendezvous of a router's robots: a free port of the loopback interface, with new passwords."""
    endpoint = f"tcp/{LOOPBACK}:{free_port()}"
    return Rendezvous(router.run, endpoint, access.passwords(router.run, endpoint, router.robots))


def by_certificates(
    address: str, port: int | None, robots: int, routers: Mapping[str, Sequence[str]] | None = None
) -> Rendezvous:
    """Return a rendezvous at an address of this host that other hosts can reach, with certificates for this run.

    `routers` maps the name of each router to the names of the robots that join through it.

    Raises ScenarioError if the address is not one of this host, or the port is taken.
    """
    from netshaper import certificates  # noqa: PLC0415  not needed on the loopback

    try:
        port = free_port(address, port or 0)
    except OSError as error:
        where = f"address = {address!r}" + (f", port = {port}" if port else "")
        raise ScenarioError(
            f"{where}: the hub cannot listen there: {error.strerror}; "
            "address must be this host's address as the other hosts know it, and the port must be free"
        ) from None
    host = f"[{address}]" if ":" in address else address  # of IPv6
    run, endpoint = secrets.token_hex(4), f"tls/{host}:{port}"
    made = certificates.make(robots, [address], routers=routers)
    return Rendezvous(run, endpoint, certificates.credentials(run, endpoint, made), made[names.RELAY])
