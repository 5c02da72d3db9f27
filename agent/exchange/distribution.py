"""Choose the dissemination of logs that the settings name."""

from __future__ import annotations

from agent.encodings.base import MapEncoding
from agent.exchange import gossip, offer_policy
from agent.exchange.confirmed import ConfirmedSession
from agent.exchange.confirmed_gossip import ConfirmedGossip
from agent.exchange.gossip import Gossip
from agent.exchange.session import Session
from agent.settings import Settings

DISSEMINATIONS = (*offer_policy.POLICIES, gossip.POLICY)
"""When, and to whom, maps are told."""


def distribution(settings: Settings, map_encoding: MapEncoding) -> Session | Gossip:
    """Return the robot's end of what distributes logs; ValueError lists the policies there are."""
    if settings.dissemination == gossip.POLICY:
        way = ConfirmedGossip if settings.requires_acks else Gossip
        return way(
            settings.robot,
            settings.robots,
            incarnations=settings.incarnations,
            incarnation=settings.incarnation,
            bases=map_encoding.dependencies,
        )
    kind = ConfirmedSession if settings.requires_acks else Session
    session = kind(
        settings.robot,
        settings.robots,
        settings.dissemination,
        incarnations=settings.incarnations,
        incarnation=settings.incarnation,
    )
    session.forwards_state = settings.forward_maps
    return session
