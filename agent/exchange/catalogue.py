"""The exchanges there are, by name."""

from __future__ import annotations

from agent.exchange.base import Exchange
from agent.exchange.laser import LaserExchange
from agent.exchange.none import NoExchange
from agent.exchange.polygon import PolygonExchange
from agent.settings import Settings
from protocol.errors import there_are

EXCHANGES: dict[str, type[Exchange]] = {
    kind.name: kind for kind in (PolygonExchange, LaserExchange, NoExchange)
}


def exchange(settings: Settings) -> Exchange:
    """Return the exchange that the settings name; ValueError lists the names there are."""
    if settings.exchange not in EXCHANGES:
        raise ValueError(
            f"no exchange is called {settings.exchange!r}; {there_are(EXCHANGES, settings.exchange)}"
        )
    return EXCHANGES[settings.exchange](settings)
