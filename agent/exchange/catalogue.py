"""The exchanges there are, by name, and the ways of distributing what they log."""

from __future__ import annotations

from agent.exchange import gossip, session
from agent.exchange.base import Exchange
from agent.exchange.confirmed import ConfirmedSession
from agent.exchange.gossip import Gossip
from agent.exchange.laser import LaserExchange
from agent.exchange.none import NoExchange
from agent.exchange.polygon import PolygonExchange
from agent.exchange.session import Session
from agent.exchange.sight import SightExchange
from agent.settings import Settings
from protocol.errors import there_are

EXCHANGES: dict[str, type[Exchange]] = {
    kind.name: kind for kind in (PolygonExchange, LaserExchange, SightExchange, NoExchange)
}


OFFERS = (*session.POLICIES, gossip.POLICY)
"""When, and to whom, maps are told."""


def distribution(settings: Settings) -> Session | Gossip:
    """Return the robot's end of what distributes logs; ValueError lists the policies there are."""
    if settings.offers == gossip.POLICY:
        return Gossip(settings.robot, settings.robots, lives=settings.lives, life=settings.life)
    kind = ConfirmedSession if settings.confirms else Session
    return kind(settings.robot, settings.robots, settings.offers, lives=settings.lives, life=settings.life)


def exchange(settings: Settings) -> Exchange:
    """Return the exchange that the settings name; ValueError lists the names there are."""
    if settings.exchange not in EXCHANGES:
        raise ValueError(
            f"no exchange is called {settings.exchange!r}; {there_are(EXCHANGES, settings.exchange)}"
        )
    return EXCHANGES[settings.exchange](settings)
