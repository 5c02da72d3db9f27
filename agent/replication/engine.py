"""The replication engine: it replicates all logs to all robots.

Each robot appends encoded map updates to a log of its own. Replication keeps a version vector of each peer (`peers`),
lets a policy choose the log ranges that peers lack (`policies`, `gossip_policy`), packs them into frames of a byte
budget, and counts entries as delivered when the medium or the peers acknowledge them:

    setting dissemination   medium          module           acknowledged by
    backoff, thesis         perfect         `handshakes`     the medium's send report
    backoff, thesis         lossy           `acked_frames`   peers' reports
    gossip                  perfect         `gossip`         the medium's send report (`delivery.MediumAcks`)
    gossip                  lossy           `gossip`         peers' reports (`delivery.PeerAcks`)
"""

from __future__ import annotations

from agent.replication.acked_frames import AckedFrames
from agent.replication.base import Replication
from agent.replication.delivery import MediumAcks, PeerAcks
from agent.replication.gossip import Gossip
from agent.replication.gossip_policy import Dependencies, no_dependencies
from agent.replication.handshakes import Handshakes
from agent.replication.peers import map_ids
from agent.replication.policies import DISSEMINATIONS, GOSSIP, POLICIES
from agent.replication.replica import Consume, Replica


def make_replication(
    robot: int,
    robots: int,
    consume: Consume,
    dissemination: str = "backoff",
    *,
    requires_acks: bool = False,
    incarnations: int = 1,
    incarnation: int = 0,
    forwards: bool = True,
    dependencies: Dependencies = no_dependencies,
) -> Replication:
    """Return one robot's end of the replication, by its settings (`agent.settings.Settings`).

    `consume` decodes received entries; `dependencies` returns log ranges that depend on entries of other logs, by map
    number. With `forwards`, handshakes offer other robots' maps as well. ValueError: there is no such dissemination.
    """
    maps = map_ids(robots, incarnations)
    replica = Replica(maps[robot + robots * incarnation], maps, consume)
    if dissemination == GOSSIP:
        acks = PeerAcks(replica.peers) if requires_acks else MediumAcks(replica.peers)
        return Gossip(replica, acks, dependencies)
    if dissemination not in POLICIES:
        raise ValueError(f"unknown dissemination {dissemination!r}; choose from: {', '.join(DISSEMINATIONS)}")
    unicast = AckedFrames if requires_acks else Handshakes
    return unicast(replica, POLICIES[dissemination], forwards=forwards)
