"""The replication engine: it replicates all logs to all robots.

Each robot appends encoded map updates to a log of its own. Replication keeps a version vector of each peer (`peers`),
lets a policy choose the log ranges that peers lack (`policies`, `gossip_policy`), packs them into frames of a byte
budget, and counts entries as delivered when the medium or the peers acknowledge them:

    setting dissemination   medium          module           acknowledged by
    backoff, thesis         perfect         `handshakes`     the medium's send report
    backoff, thesis         lossy           `acked_frames`   peers' reports
    gossip                  perfect         `gossip`         the medium's send report (`delivery.Acks`)
    gossip                  lossy           `gossip`         peers' reports (`delivery.Acks`)
"""

from __future__ import annotations

from agent.replication.acked_frames import AckedFrames
from agent.replication.base import Replication
from agent.replication.delivery import Acks
from agent.replication.gossip import Gossip
from agent.replication.gossip_policy import Dependencies
from agent.replication.handshakes import Handshakes
from agent.replication.peers import map_ids
from agent.replication.policies import DISSEMINATIONS, GOSSIP, POLICIES
from agent.replication.replica import Consume, Rebuild, Replica
from agent.settings import Settings


def make_replication(
    settings: Settings, consume: Consume, dependencies: Dependencies, rebuild: Rebuild
) -> Replication:
    """Return a robot's end of the replication, by its settings; ValueError if there is no such dissemination.

    `consume` decodes received entries; `dependencies` returns log ranges that depend on other logs, by map number;
    `rebuild` decodes all logs again after entries were dropped.
    """
    replication = settings.replication
    maps = map_ids(settings.robots, settings.incarnations)
    own = maps[settings.own_map]
    replica = Replica(own, maps, consume, rebuild, ordered=not replication.requires_acks)
    if replication.dissemination == GOSSIP:
        acks = Acks(replica.peers, reliable=not replication.requires_acks)
        return Gossip(replica, acks, dependencies)
    policy = POLICIES.get(replication.dissemination)
    if policy is None:
        known = ", ".join(DISSEMINATIONS)
        raise ValueError(f"unknown dissemination {replication.dissemination!r}; choose from: {known}")
    unicast = AckedFrames if replication.requires_acks else Handshakes
    return unicast(replica, policy, forwards=replication.forward_maps)
