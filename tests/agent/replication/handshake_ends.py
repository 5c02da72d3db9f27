"""One end of handshakes, and what the medium reports to it."""

from __future__ import annotations

from collections.abc import Sequence

from agent.replication.base import Replication
from protocol import packet_index
from protocol.messages import ConnectionReport, Delivery, OutgoingFrame, RoundReport
from protocol.packet_codec import encode
from protocol.packets import DECLINED, Block
from tests.agent.replication.network import make_engine


def engine(robot: int = 0, robots: int = 2) -> Replication:
    """An engine that can decode everything."""
    return make_engine(robot, robots, lambda *received: packet_index.ends(received[-1]))


def closing(*connections: ConnectionReport, data: Sequence[Delivery] = ()) -> RoundReport:
    return RoundReport(0, 0, list(connections), [], list(data), False)


def declines(offers: Sequence[Delivery]) -> list[OutgoingFrame]:
    return [OutgoingFrame(each.sender, encode([Block(DECLINED)]), each.connection) for each in offers]
