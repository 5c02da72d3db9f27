"""Zenoh sessions as ROS 2 has them: clients of a router on this host, messages with time stamps, no multicast.

Priorities are on, as in rmw_zenoh. Without them, a session that dropped one message because its queue was full would
drop all later ones: zenoh 1.10 marks the queue of the default priority as full, and clears the mark of another one.
"""

from __future__ import annotations

import zenoh

from protocol.zenoh_bus import insert, plain_config

ROUTER = "tcp/localhost:7447"
"""Where the router of rmw_zenoh listens."""
CONNECT_S = 5.0


def open_client(router: str = ROUTER, timeout_s: float = CONNECT_S) -> zenoh.Session:
    """Open a session of a node; ConnectionError if no router answers within `timeout_s`."""
    config = _config("client", "connect", router, "the address of a router")
    insert(config, "connect/timeout_ms", int(1000 * timeout_s))
    advice = "with ROS 2, start it with: ros2 run rmw_zenoh_cpp rmw_zenohd"
    return _open(config, f"no Zenoh router answers at {router} within {timeout_s:g} s; {advice}")


def open_router(endpoint: str = ROUTER) -> zenoh.Session:
    """Open a router, for hosts without that of ROS 2; ConnectionError if it cannot listen at `endpoint`."""
    config = _config("router", "listen", endpoint, "an address to listen at")
    return _open(config, f"cannot listen at {endpoint}: the address is in use, or not one of this host")


def _open(config: zenoh.Config, failure: str) -> zenoh.Session:
    try:
        return zenoh.open(config)
    except zenoh.ZError:
        raise ConnectionError(failure) from None


def _config(mode: str, side: str, address: str, kind: str) -> zenoh.Config:
    """Return the configuration to ``connect`` or ``listen`` at an address; ValueError if it is not of this `kind`."""
    config = plain_config(mode)
    try:
        insert(config, f"{side}/endpoints", [address])
    except zenoh.ZError:
        raise ValueError(f"{address!r} is not {kind}, as {ROUTER}") from None
    insert(config, f"{side}/exit_on_failure", True)
    insert(config, "timestamping/enabled", True)
    insert(config, "transport/unicast/qos/enabled", True)
    return config
