"""The replication engine: it replicates all logs to all robots.

Each robot appends encoded map updates to a log of its own. Replication keeps a version vector of each peer (`peers`),
lets a policy choose the log ranges that peers lack (`policies`, `gossip_policy`), packs them into frames of a byte
budget, and counts entries as delivered when the medium or the peers acknowledge them:

    setting dissemination   medium          module           acknowledged by
    backoff, thesis         perfect         `handshakes`     the medium's send report
    backoff, thesis         lossy           `acked_frames`   peers' reports
    gossip                  perfect         `gossip`         the medium's send report (`delivery.Acks`)
    gossip                  lossy           `gossip`         peers' reports (`delivery.Acks`)

Plug-ins (`protocol.plugins`) travel like ``backoff``: a subclass of `OfferDissemination` chooses offers and receivers.
"""

from __future__ import annotations

from agent.replication.acked_frames import AckedFrames
from agent.replication.base import Replication
from agent.replication.gossip import Gossip
from agent.replication.gossip_policy import Dependencies
from agent.replication.handshakes import Handshakes
from agent.replication.peers import PeerTable
from agent.replication.policies import GOSSIP, Backoff, OfferDissemination, Rounds, Thesis
from agent.replication.replica import Consume, Rebuild, Replica
from agent.settings import Settings
from protocol.plugins import Plugins

__all__ = ["DISSEMINATIONS", "PLUGINS", "OfferDissemination", "make_replication"]

Dissemination = type[OfferDissemination] | type[Gossip]

DISSEMINATIONS: dict[str, Dissemination] = {Backoff.name: Backoff, Thesis.name: Thesis, GOSSIP: Gossip}
"""The values of the scenario's setting `dissemination`, besides plug-ins."""

PLUGINS: Plugins[Dissemination] = Plugins(
    "dissemination", "murmur.disseminations", OfferDissemination, DISSEMINATIONS, OfferDissemination
)


def make_replication(
    settings: Settings, consume: Consume, dependencies: Dependencies, rebuild: Rebuild
) -> Replication:
    """Return a robot's end of the replication, by its settings; ValueError if there is no such dissemination.

    `consume` decodes received entries; `dependencies` returns log ranges that depend on other logs, by map ID;
    `rebuild` decodes all logs again after entries were dropped.
    """
    dissemination = PLUGINS.find(settings.replication.dissemination)
    reliable, round_trip = not settings.replication.requires_acks, settings.replication.round_trip
    peers = PeerTable(
        settings.own_map, settings.robots, settings.maps, reliable=reliable, round_trip=round_trip
    )
    replica = Replica(peers, consume, rebuild)
    if issubclass(dissemination, Gossip):
        return Gossip(replica, dependencies)
    rounds = Rounds(replica, dissemination(), forwards=settings.replication.forward_maps)
    return Handshakes(replica, rounds) if reliable else AckedFrames(replica, rounds)
