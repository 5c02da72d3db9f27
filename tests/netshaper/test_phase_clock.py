"""The relay by the wall clock: phases of the medium end on time, and late robots miss them."""

from __future__ import annotations

from typing import Any

import pytest

from netshaper.ledger import ROW
from netshaper.phase_clock import RecordedPhases, WallPhases
from netshaper.settings import RadioSettings
from protocol.budget import Budget
from protocol.messages import (
    Close,
    ErrorReport,
    Missed,
    Open,
    OutgoingFrame,
    PhaseDelivery,
    RadioReport,
    RobotFrames,
)
from protocol.packet_codec import encode
from protocol.packets import Offer, Pose
from tests.netshaper.test_relay import RECORDER, WORLD, Run

STEP_NS = 1200
SETTINGS = RadioSettings(3, 0, 100.0, Budget(1000))
"""Settings with handshakes: two rounds of three phases."""


class WallRun(Run):
    """A relay by the wall clock, of which the test sets the time."""

    def __init__(self) -> None:
        super().__init__(3, budget=Budget(1000), clock=WallPhases(STEP_NS, SETTINGS))

    def at(self, now_ns: int) -> int | None:
        """Let the time pass without a message; return the next deadline."""
        self.relay.tick(now_ns)
        return self.relay.deadline(now_ns)

    def answer(
        self, *names: str, phase: str = "offers", number: int = 0, step: int = 1, **frames: Any
    ) -> None:
        for name in names:
            self.send(name, RobotFrames(step, number, phase, **frames))

    def opened(self, name: str) -> list[tuple[int, int]]:
        return [(event.step, event.round) for event in self.received(name) if isinstance(event, Open)]


def test_deadlines_leave_a_third_of_a_step_for_the_robots_plans() -> None:
    clock = WallPhases(STEP_NS, SETTINGS)
    names = [(number, name) for number in (0, 1) for name in ("offers", "answers", "data")]
    deadlines = [clock.deadline((1, number, name), 5000) or 0 for number, name in names]
    assert deadlines[0] == 5000 + STEP_NS // 3
    assert deadlines == sorted(set(deadlines))
    assert deadlines[-1] <= 5000 + 2 * STEP_NS // 3
    assert clock.deadline((1, 2, ""), 5100) is None
    assert clock.deadline((2, 0, "offers"), 6000) == 6000 + STEP_NS // 3


def test_a_late_robot_misses_the_rest_of_the_medium_and_nobody_waits_for_it() -> None:
    run = WallRun()
    run.begin_step()
    due = run.at(0)
    assert due == STEP_NS // 3
    run.answer("r0", "r1")
    assert run.relay.waiting_for() == []
    run.at(due - 1)
    assert not [event for event in run.received("r0") if isinstance(event, Close)]
    run.at(due)
    assert run.received(RECORDER) == [Missed(1, "offers", 0, [2])]
    run.answer("r0", "r1", number=1)
    assert [event.step for event in run.received(WORLD)] == [1]
    assert run.opened("r2") == [(1, 0)]
    run.begin_step(2)
    run.answer("r2")
    run.answer("r0", "r1", "r2", step=2)
    assert run.opened("r2") == [(2, 0), (2, 1)]
    assert not [report for report in run.received(RECORDER) if isinstance(report, ErrorReport)]


def test_late_frames_are_neither_carried_nor_logged() -> None:
    run = WallRun()
    run.begin_step()
    run.answer("r0", "r1")
    run.at(0)
    run.at(STEP_NS)
    run.answer("r2", broadcast=encode([Pose(5, 5, 0)]))
    run.answer("r0", "r1", number=1)
    (report,) = [report for report in run.received(RECORDER) if isinstance(report, RadioReport)]
    assert len(report.rows) // ROW.itemsize == 0
    assert report.carried == 0


def test_an_offer_to_a_robot_that_missed_a_phase_is_lost() -> None:
    run = WallRun()
    run.begin_step()
    offer = encode([Offer(0, 0)])
    run.answer("r0", frames=[OutgoingFrame(2, offer), OutgoingFrame(1, offer)])
    run.answer("r1")
    run.at(0)
    run.at(STEP_NS // 3)
    assert run.received("r2")[-1:] == [Open(1, 0, [0, 1], Budget(1000))]
    (delivery,) = [event for event in run.received("r1") if isinstance(event, PhaseDelivery)]
    assert [(each.sender, each.payload) for each in delivery.deliveries] == [(0, offer)]


def test_recorded_phases_repeat_what_robots_missed() -> None:
    record = [Missed(1, "offers", 0, [2]), Missed(1, "move", 0, [0])]
    run = Run(3, budget=Budget(1000), clock=RecordedPhases(record))
    run.begin_step()
    assert run.relay.waiting_for() == [0, 1]
    assert run.received(RECORDER) == record[:1]
    run.send("r2", RobotFrames(1, 0, "offers", encode([Pose(5, 5, 0)])))
    for number in (0, 1):
        run.send("r0", RobotFrames(1, number, "offers"))
        run.send("r1", RobotFrames(1, number, "offers"))
    reports = run.received(RECORDER)
    assert [type(report) for report in reports] == [RadioReport]
    assert reports[0].carried == 0


@pytest.mark.parametrize("gossip", [True, False])
def test_rounds_of_gossip_have_one_phase(gossip: bool) -> None:
    clock = WallPhases(STEP_NS, RadioSettings(3, 0, 100.0, Budget(1000), gossip=gossip))
    second = clock.deadline((1, 1, "offers"), 0)
    assert second == STEP_NS * (3 if gossip else 9) // (6 if gossip else 18)
