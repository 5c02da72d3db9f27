"""Outcome of a round as parallel lists, as sessions and gossip read it."""

from __future__ import annotations

from dataclasses import dataclass

from protocol.messages import RoundReport


@dataclass(frozen=True)
class Outcome:
    """What was on the air in a round.

    `connections`, `offers`, `answers`, `data` are parallel: the bytes of each frame that were carried; broadcasts and
    frames without a connection have the connection -1. `heard`: the connections of the data that arrived.
    `broadcast`: whether this robot's pose and target were carried.
    """

    step: int
    round: int
    connections: list[int]
    offers: list[int]
    answers: list[int]
    data: list[int]
    heard: list[int]
    broadcast: bool

    @classmethod
    def of(cls, report: RoundReport) -> Outcome:
        """Read the relay's report."""
        ends = report.connections
        sent = [0] * (1 + max([each.frame for each in report.sent], default=-1))
        for each in report.sent:
            sent[each.frame] = each.sent
        nothing = [0] * len(sent)
        return cls(
            report.step,
            report.round,
            [each.connection for each in ends] + [-1] * len(sent),
            [each.offer for each in ends] + nothing,
            [each.answer for each in ends] + nothing,
            [each.data for each in ends] + sent,
            [each.connection for each in report.deliveries],
            report.broadcast_sent,
        )
