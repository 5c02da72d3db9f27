"""A router between the robots of one host and the hub: Zenoh's own router mode, with the hub's access control.

Robots join it by passwords on the loopback, as they would a hub; it joins the hub over mutual TLS, as one client that
speaks for all of them. So a host needs one connection, however many robots it has. It routes, and knows nothing of what
is said.
"""

from __future__ import annotations

import time
from collections.abc import Mapping

from netshaper import access
from netshaper.hub import asking, listening
from protocol.keys import Keys
from protocol.zenoh_bus import Credential, insert, open_connected, receive_apart

LOOK_S, TIMES = 0.25, 2
"""How often the hub is looked for, and how often running it must be missing before it is gone."""


class Router:
    """One host's router, from the moment that the hub has let it in.

    Parameters
    ----------
    credential : Credential
        The router's own, for the hub; it names the robots.
    endpoint : str
        Where the robots find it.
    credentials : mapping of str to Credential
        What they show, by name.

    Raises
    ------
    ConnectionError
        The hub does not answer or refuses the credential, or the endpoint is taken.
    """

    def __init__(self, credential: Credential, endpoint: str, credentials: Mapping[str, Credential]) -> None:
        receive_apart()
        config = listening(endpoint)
        insert(config, "access_control", access.router_rules(Keys(credential.run), credential.robots))
        with asking(config, credentials):
            self._session = open_connected(config, credential)

    def serve(self) -> None:
        """Route until the hub is gone. That is for the robots to tell of: it may be how the run ends."""
        missing = 0
        while missing < TIMES:
            time.sleep(LOOK_S)
            missing = 0 if self._session.info.routers_zid() else missing + 1

    def close(self) -> None:
        """Leave the hub and the robots."""
        self._session.close()  # type: ignore[no-untyped-call]
