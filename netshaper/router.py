"""A router between the robots of one host and the hub: Zenoh's own router mode, with the hub's access control.

Robots join it with passwords over the loopback interface, like a hub. The router joins the hub over mutual TLS, as one
client that represents all of them, so a host needs one connection for any number of robots. A router forwards messages
without decoding them.
"""

from __future__ import annotations

import time
from collections.abc import Mapping

from netshaper import access
from netshaper.hub import listening, password_check
from protocol.keys import Keys
from protocol.zenoh_bus import Credential, insert, open_connected, receive_apart

CHECK_S, MAX_MISSES = 0.25, 2
"""Interval between checks for the hub, and consecutive failed checks after which the hub counts as lost."""


class Router:
    """One host's router, connected to the hub.

    Its own `credential` for the hub names the robots. It listens at the address `endpoint` for them; `credentials` are
    theirs for the router, by name. Raises ConnectionError if the hub does not answer or refuses the credential, or the
    endpoint is in use.
    """

    def __init__(self, credential: Credential, endpoint: str, credentials: Mapping[str, Credential]) -> None:
        receive_apart()
        config = listening(endpoint)
        insert(config, "access_control", access.router_rules(Keys(credential.run), credential.robots))
        with password_check(config, credentials):
            self._session = open_connected(config, credential)

    def serve(self) -> None:
        """Route until the hub is lost. The robots report the loss, because a run may also end this way."""
        missing = 0
        while missing < MAX_MISSES:
            time.sleep(CHECK_S)
            missing = 0 if self._session.info.routers_zid() else missing + 1

    def close(self) -> None:
        """Disconnect from the hub and the robots."""
        self._session.close()  # type: ignore[no-untyped-call]
