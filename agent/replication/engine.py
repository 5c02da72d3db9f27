"""The replication engine: frames in, frames out, rejections as events. It does no I/O and reads no clock.

Each robot appends encoded map updates to a log of its own. The engine replicates all logs to all robots. It keeps a
version vector of each peer (`peers`), lets a policy choose the log ranges that peers lack (`policies`,
`gossip_policy`), packs them into frames of a byte budget (`frame_builder`), and counts entries as delivered when the
medium or the peers acknowledge them. Three disseminations cover all settings:

    setting dissemination   medium          module           acknowledged by
    backoff, thesis         perfect         `handshakes`     the medium's send report
    backoff, thesis         lossy           `acked_frames`   peers' reports
    gossip                  perfect         `gossip`         the medium's send report (`delivery.MediumAcks`)
    gossip                  lossy           `gossip`         peers' reports (`delivery.PeerAcks`)

A round: `open_round` returns frames; on a perfect medium `answer` and `send_data` continue a handshake; `close_round`
takes what was on the air and what arrived. Entries that arrived go to the `consume` callback, which decodes them; if it
raises ProtocolError, the sender's entries are rejected from then on (`replica`).
"""

from __future__ import annotations

from collections.abc import Sequence

from agent.replication.acked_frames import AckedFrames
from agent.replication.delivery import MediumAcks, PeerAcks
from agent.replication.gossip import Gossip
from agent.replication.gossip_policy import Dependencies, no_dependencies
from agent.replication.handshakes import Handshakes
from agent.replication.log import Log
from agent.replication.map_ids import map_ids
from agent.replication.peers import PeerTable
from agent.replication.policies import DISSEMINATIONS, GOSSIP, POLICIES
from agent.replication.replica import Consume, Rejected, Replica
from agent.settings import Settings
from protocol.errors import ProtocolError
from protocol.messages import NO_REPLIES, Delivery, OutgoingFrame, Replies, RoundReport


class Replication:
    """One robot's end of the replication of all maps.

    Parameters
    ----------
    robot, robots : int
        This robot's number, and the size of the team.
    consume : callable
        Decodes received entries (`agent.replication.replica.Consume`).
    dissemination : str
        One of `DISSEMINATIONS`.
    requires_acks : bool
        Whether the medium may lose frames, so that only peers can acknowledge.
    incarnations, incarnation : int
        How often each robot may begin, and which time this is.
    forwards : bool
        Whether handshakes offer other robots' maps as well.
    dependencies : callable
        Log ranges that depend on entries of other logs, by map number.

    Raises
    ------
    ValueError
        There is no such dissemination.
    """

    def __init__(
        self,
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
    ) -> None:
        maps = map_ids(robots, incarnations)
        self.own = maps[robot + robots * incarnation]
        """This robot's map."""
        self.replica = replica = Replica(self.own, maps, consume)
        self.logs: list[Log] = replica.logs
        """All logs, by map number."""
        self.peers: PeerTable = replica.peers
        """Version vectors of the peers."""
        self.distrusted: set[int] = replica.distrusted
        """Peers from which no entries are accepted."""
        self._handshakes: Handshakes | None = None
        self._dissemination: Handshakes | AckedFrames | Gossip
        if dissemination == GOSSIP:
            acks = PeerAcks(self.peers) if requires_acks else MediumAcks(self.peers)
            self._dissemination = Gossip(replica, acks, dependencies)
        elif dissemination not in POLICIES:
            raise ValueError(
                f"unknown dissemination {dissemination!r}; choose from: {', '.join(DISSEMINATIONS)}"
            )
        elif requires_acks:
            self._dissemination = AckedFrames(replica, POLICIES[dissemination], forwards=forwards)
        else:
            self._handshakes = Handshakes(replica, POLICIES[dissemination], forwards=forwards)
            self._dissemination = self._handshakes

    @classmethod
    def from_settings(cls, settings: Settings, consume: Consume, dependencies: Dependencies) -> Replication:
        """Return the engine that a robot's settings describe."""
        return cls(
            settings.robot,
            settings.robots,
            consume,
            settings.dissemination,
            requires_acks=settings.requires_acks,
            incarnations=settings.incarnations,
            incarnation=settings.incarnation,
            forwards=settings.forward_maps,
            dependencies=dependencies,
        )

    @property
    def priority(self) -> int:
        """Priority of this round's frames: the higher, the shorter a broadcast waits for a free medium."""
        return self._dissemination.priority

    @property
    def shared(self) -> int:
        """Offset in this robot's log before which other robots may hold entries; those from there on may change."""
        return self._dissemination.shared

    def append(self, entries: list[bytes]) -> None:
        """Append entries to this robot's log."""
        self.replica.append(entries)

    def retract(self, count: int) -> bool:
        """Remove the last `count` entries of this robot's log if no other robot can hold any; return whether it did."""
        return self.replica.own_log.retract(count, self.shared)

    def open_round(self, number: int, in_range: list[int], budget: int | None) -> list[OutgoingFrame]:
        """Return the frames to send in round `number` of a step.

        `in_range` are the peers in radio range; `budget` is what is left of the step's bytes, None for no limit.
        """
        return self._dissemination.open_round(number, in_range, budget)

    def speculative(self) -> Replies:
        """Return the answers and data that this robot would send in this round, so that the relay need not ask."""
        return self._handshakes.speculative() if self._handshakes is not None else NO_REPLIES

    def answer(self, offers: Sequence[Delivery]) -> list[OutgoingFrame]:
        """Answer the offers of a round; ProtocolError if one is malformed, or this dissemination has no offers."""
        if self._handshakes is None:
            raise ProtocolError("conn", 0, f"{len(offers)} offers, but maps travel without handshakes")
        return self._handshakes.answer(offers)

    def send_data(self, answers: Sequence[Delivery]) -> list[OutgoingFrame]:
        """Send the entries that answers ask for; ProtocolError as in `answer`."""
        if self._handshakes is None:
            raise ProtocolError("conn", 0, f"{len(answers)} answers, but maps travel without handshakes")
        return self._handshakes.send_data(answers)

    def close_round(self, report: RoundReport) -> list[Rejected]:
        """Take what was on the air of this robot's frames, and the frames that arrived; return rejections."""
        self._dissemination.close_round(report)
        return self.replica.take_rejected()

    def delivered(self) -> bool:
        """Return whether peers are in range, and all of them hold this robot's log."""
        return self._dissemination.delivered()

    def undelivered(self) -> int:
        """Count the entries of this robot's log that peers have not acknowledged, over all peers."""
        return self.peers.unacked(len(self.replica.own_log))

    def truncate(self) -> None:
        """Drop log entries that all robots acknowledged."""
        self.replica.truncate()
