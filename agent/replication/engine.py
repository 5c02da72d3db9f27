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

from abc import ABC, abstractmethod
from typing import ClassVar

from agent.replication.acked_frames import AckedFrames
from agent.replication.base import Replication
from agent.replication.gossip import Gossip
from agent.replication.gossip_policy import Dependencies
from agent.replication.handshakes import Handshakes
from agent.replication.peers import PeerTable, Table
from agent.replication.policies import GOSSIP, Offer, Rounds, backoff, thesis
from agent.replication.replica import Consume, Rebuild, Replica
from agent.settings import ReplicationSettings, Settings
from protocol.plugins import Plugins


class Dissemination(ABC):
    """How the logs of maps reach all robots."""

    name: ClassVar[str]

    @abstractmethod
    def make(
        self, settings: ReplicationSettings, replica: Replica, dependencies: Dependencies
    ) -> Replication:
        """Return a robot's end of the replication of `replica`; `dependencies` as for `make_replication`."""


class OfferDissemination(Dissemination):
    """Robots offer log ranges to each other, and send the entries that the receiver asks for."""

    def make(
        self, settings: ReplicationSettings, replica: Replica, dependencies: Dependencies
    ) -> Replication:
        """Return the end of the replication that fits the medium."""
        del dependencies
        unicast = AckedFrames if settings.requires_acks else Handshakes
        return unicast(replica, self.offers, forwards=settings.forward_maps)

    @abstractmethod
    def offers(self, rounds: Rounds, lengths: Table) -> list[Offer]:
        """Return the offers of a round, at most one per peer and map.

        Parameters
        ----------
        rounds : Rounds
            The peers in range, the entries that each is known to hold, and the rounds so far.
        lengths : int64 array, shape (maps,)
            Entries of each map that this robot may offer.
        """


class Backoff(OfferDissemination):
    """One map per peer, with exponential back-off after refusals."""

    name = "backoff"

    def offers(self, rounds: Rounds, lengths: Table) -> list[Offer]:
        """Return the offers of a round."""
        return backoff(rounds, lengths)


class Thesis(OfferDissemination):
    """All that each peer lacks."""

    name = "thesis"

    def offers(self, rounds: Rounds, lengths: Table) -> list[Offer]:
        """Return the offers of a round."""
        return thesis(rounds, lengths)


class GossipDissemination(Dissemination):
    """Robots broadcast their logs, and forward those of others."""

    name = GOSSIP

    def make(
        self, settings: ReplicationSettings, replica: Replica, dependencies: Dependencies
    ) -> Replication:
        """Return a robot's end of the gossip."""
        return Gossip(replica, dependencies, reliable=not settings.requires_acks)


DISSEMINATIONS: dict[str, type[Dissemination]] = {
    kind.name: kind for kind in (Backoff, Thesis, GossipDissemination)
}
"""The values of the scenario's setting `dissemination`, besides plug-ins."""

PLUGINS: Plugins[type[Dissemination]] = Plugins(
    "dissemination", "murmur.disseminations", OfferDissemination, DISSEMINATIONS, OfferDissemination
)


def make_replication(
    settings: Settings, consume: Consume, dependencies: Dependencies, rebuild: Rebuild
) -> Replication:
    """Return a robot's end of the replication, by its settings; ValueError if there is no such dissemination.

    `consume` decodes received entries; `dependencies` returns log ranges that depend on other logs, by map number;
    `rebuild` decodes all logs again after entries were dropped.
    """
    replication = settings.replication
    peers = PeerTable(settings.own_map, settings.robots, settings.maps)
    replica = Replica(peers, consume, rebuild, ordered=not replication.requires_acks)
    return PLUGINS.find(replication.dissemination)().make(replication, replica, dependencies)
