"""A run has finished when a robot reports the end and the team has seen the area, and not before."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from deploy.record.records import Records
from deploy.record.summary import summarize
from deploy.run.exploration import NOT_FINISHED, conclude
from deploy.run.in_memory import MemoryRun
from deploy.run.launch import Outcome
from deploy.scenario.plan import Plan
from protocol import keys as names
from protocol import rights
from protocol.bus import Bus
from protocol.messages import End, Move, OutgoingFrame, RobotFrames, pack
from tests.system.team import small_plan


class Boaster:
    """A robot's end of the bus that reports the end of exploration with its first move."""

    def __init__(self, inner: Bus) -> None:
        self._inner = inner
        self.receive, self.close = inner.receive, inner.close

    def put(self, key: str, payload: bytes) -> None:
        if names.parts(key)[0] == "body":
            message = rights.read(key, payload)
            payload = pack(replace(message, explored=isinstance(message, Move)))
        self._inner.put(key, payload)


def boasted(**settings: object) -> tuple[Plan, Records]:
    plan = small_plan(robots=2, **settings)
    return plan, MemoryRun(plan, wrap=lambda name, bus: Boaster(bus) if name == "r1" else bus).complete()


@pytest.mark.parametrize("least", [0.0, 0.9])
def test_a_run_has_not_finished_if_a_robot_stops_before_the_team_has_seen_enough(least: float) -> None:
    plan, records = boasted(min_coverage=least)
    assert records.end == End(1, "explored", 1)
    assert 0 < records.explored < 0.9
    result = conclude(plan, Outcome(records, {}), None, 1.0)
    if least:
        assert not result.summary["finished"]
        assert result.summary["reason"] == "robot 1 stopped too early"
        assert result.exit_code == NOT_FINISHED
    else:
        assert result.summary["finished"]
        assert result.summary["reason"] == "explored"
    assert result.summary["first_robot"] == 1


def test_the_world_determines_the_explored_share() -> None:
    plan, records = boasted()
    for grid in records.own.values():
        assert grid.shape == plan.map.cells.shape
    records.own = dict.fromkeys(records.own, plan.map.cells)
    assert not summarize(plan, records, 1.0)["finished"]


class FrameRepeater:
    """A bus connection that sends the same frame ten times, outside its phase, before each move of its robot."""

    def __init__(self, inner: Bus) -> None:
        self._inner = inner
        self.receive, self.close = inner.receive, inner.close

    def put(self, key: str, payload: bytes) -> None:
        if names.parts(key)[0] == "body":
            message = pack(RobotFrames(1, 0, "offers", frames=10 * [OutgoingFrame(0, b"\x80\x00")]))
            self._inner.put(key.replace("body/rx/world/r1", "radio/tx/r1"), message)
        self._inner.put(key, payload)


def test_equal_frames_that_were_not_delivered_are_counted_one_by_one() -> None:
    plan = small_plan(robots=2, steps=3)
    records = MemoryRun(plan, wrap=lambda name, bus: FrameRepeater(bus) if name == "r1" else bus).complete()
    assert summarize(plan, records, 1.0)["undelivered"]["protocol"] >= 20
