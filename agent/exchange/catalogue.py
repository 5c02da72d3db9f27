"""The exchanges there are, by name, and the ways of distributing what they log."""

from __future__ import annotations

from agent.exchange import gossip, offer_policy
from agent.exchange.base import Exchange
from agent.exchange.confirmed import ConfirmedSession
from agent.exchange.confirmed_gossip import ConfirmedGossip
from agent.exchange.gossip import Gossip
from agent.exchange.grid import GridExchange
from agent.exchange.laser import LaserExchange
from agent.exchange.none import NoExchange
from agent.exchange.polygon import PolygonExchange
from agent.exchange.session import Session
from agent.exchange.sight import SightExchange
from agent.plugins import Plugins
from agent.settings import Settings

EXCHANGES: dict[str, type[Exchange]] = {
    kind.name: kind for kind in (PolygonExchange, LaserExchange, GridExchange, SightExchange, NoExchange)
}


OFFERS = (*offer_policy.POLICIES, gossip.POLICY)
"""When, and to whom, maps are told."""


def distribution(settings: Settings, exchange: Exchange) -> Session | Gossip:
    """Return the robot's end of what distributes logs; ValueError lists the policies there are."""
    if settings.offers == gossip.POLICY:
        way = ConfirmedGossip if settings.confirms else Gossip
        return way(
            settings.robot, settings.robots, lives=settings.lives, life=settings.life, bases=exchange.bases
        )
    kind = ConfirmedSession if settings.confirms else Session
    session = kind(settings.robot, settings.robots, settings.offers, lives=settings.lives, life=settings.life)
    session.passes_on = settings.pass_on
    return session


PLUGINS: Plugins[Exchange] = Plugins("exchange", "murmur.exchanges", Exchange)  # type: ignore[type-abstract]
"""Those that are not ours."""


def exchange_kind(name: str) -> type[Exchange]:
    """Return the exchange called `name`: one of ours, of an installed package, or ``package.module:Class``.

    Raises
    ------
    ValueError
        There is none of that name (near names and those there are follow), or the class cannot be imported.
    """
    return PLUGINS.find(name, EXCHANGES)


def exchange(settings: Settings) -> Exchange:
    """Return the exchange that the settings name; ValueError lists the names there are."""
    return exchange_kind(settings.exchange)(settings)
