"""A run has finished when a robot reports the end and the team has seen the area, and not before."""

from __future__ import annotations

import zlib
from statistics import fmean

import numpy as np
from msgspec.structs import replace

from deploy.commands.terminal import summary_lines
from deploy.record.records import Records
from deploy.record.summary import summarize
from deploy.run.exit_codes import NOT_FINISHED
from deploy.run.in_memory import MemoryRun
from deploy.run.launch import Outcome
from deploy.run.result import conclude
from deploy.scenario.plan import Plan
from protocol import keys as names
from protocol import rights
from protocol.bus import Bus
from protocol.grid import FREE
from protocol.message_codec import pack
from protocol.messages import End, MapPart, Move, OutgoingFrame, RobotFrames
from tests.system.team import small_plan


class Boaster:
    """A robot's end of the bus that reports the end of exploration with its first move."""

    cells = 0
    """Number of cells of the map."""

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


def test_one_robot_that_reports_the_end_too_early_does_not_end_the_run() -> None:
    plan, records = boasted()
    assert records.end is not None
    assert records.end.reason == "explored"
    assert records.end.step > 20
    assert records.explored == 1
    assert len(records.protocol_errors.texts) == 1
    assert records.protocol_errors.texts[0].startswith(
        "r1: robot 1 reported 'explored' when the team had seen "
    )
    assert summarize(plan, records, 1.0)["finished"]


def test_the_run_ends_if_all_robots_report_the_end_too_early() -> None:
    plan = small_plan(robots=2)
    records = MemoryRun(plan, wrap=lambda name, bus: Boaster(bus) if name[1:].isdigit() else bus).complete()
    assert records.end == End(1, "explored", 0)
    result = conclude(plan, Outcome(records, {}), None, 1.0)
    assert not result.summary["finished"]
    assert result.summary["reason"] == "robot 0 stopped too early"
    assert result.exit_code == NOT_FINISHED


def test_a_scenario_can_let_the_first_report_end_the_run() -> None:
    plan, records = boasted(min_coverage=0.0)
    assert records.end == End(1, "explored", 1)
    assert 0 < records.explored < 0.9
    assert summarize(plan, records, 1.0)["finished"]


class FalseMaps(Boaster):
    """A robot's end of the bus that also hands in maps on which all cells are free."""

    def put(self, key: str, payload: bytes) -> None:
        if names.parts(key)[0] == "control":
            message = rights.read(key, payload)
            if isinstance(message, MapPart):
                payload = pack(MapPart(message.part, zlib.compress(bytes([5]) * self.cells)))
        super().put(key, payload)


def test_false_maps_at_the_end_change_no_result_of_the_others() -> None:
    plan = small_plan(robots=3, steps=25)
    honest = summarize(plan, MemoryRun(plan).complete(), 1.0)
    FalseMaps.cells = plan.map.cells.size
    records = MemoryRun(plan, wrap=lambda name, bus: FalseMaps(bus) if name == "r0" else bus).complete()
    summary = summarize(plan, records, 1.0)
    assert honest["refuted_maps"] == []
    assert summary["refuted_maps"] == [0]
    assert summary["coverage"] == honest["coverage"] < 0.99
    assert summary["map_accuracy"] is summary["claimed_map_accuracy"] is None
    assert not summary["finished"]
    everyone = [records.own[robot] for robot in (1, 2)]
    assert (records.team_map(summary["refuted_maps"]) == np.maximum.reduce(everyone)).all()


def test_no_robot_has_a_more_accurate_map_than_the_team_has_seen() -> None:
    plan = small_plan(robots=2, steps=10)
    records = MemoryRun(plan).complete()
    records.planning[0] = np.full_like(records.planning[0], FREE)
    summary = summarize(plan, records, 1.0)
    assert summary["claimed_map_accuracy"] == 1
    assert summary["map_accuracy"] == summary["coverage"] < 0.9


def test_success_is_that_of_the_first_robot_of_the_worst_and_the_mean() -> None:
    plan = small_plan(robots=3, map_encoding="none")
    summary = summarize(plan, MemoryRun(plan).complete(), 1.0)
    shares = [summary["robot_maps"][str(robot)]["map_accuracy"] for robot in range(3)]
    assert shares[0] < shares[2] < shares[1] == summary["map_accuracy"] == 1
    assert summary["first_robot"] == 1
    assert summary["worst_map_accuracy"] == summary["claimed_worst_map_accuracy"] == shares[0]
    assert summary["mean_map_accuracy"] == summary["claimed_mean_map_accuracy"] == fmean(shares)
    mean, worst = (f"{100 * share:.2f} %" for share in (fmean(shares), shares[0]))
    line = f"Map accuracy: mean {mean}, worst {worst} (robot 0), first to finish 100.00 % (robot 1)."
    assert line in summary_lines(summary, None, noisy=False)


def test_a_scenario_can_require_that_all_robots_finish() -> None:
    plan = small_plan(robots=3, map_encoding="none", finish="all")
    summary = summarize(plan, MemoryRun(plan).complete(), 1.0)
    assert summary["finished"]
    assert summary["worst_map_accuracy"] == 1
    lines = summary_lines(summary, None, noisy=False)
    assert lines[0].startswith(f"Explored in {summary['steps']} steps by all robots; robot ")
    assert "Map accuracy: 100.00 % on each robot." in lines


def test_the_world_determines_the_explored_share() -> None:
    plan, records = boasted(steps=5)
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
