"""Runs by the wall clock: robots that are late miss steps, the others do not wait, and the run repeats."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from deploy.after.report import write_report
from deploy.commands.terminal import summary_lines
from deploy.record.missed_phases import MISSED
from deploy.record.records import Records
from deploy.record.summary import digest, summarize
from deploy.run.control import why_unrepeatable
from deploy.run.exploration import explore
from deploy.run.in_memory import MemoryRun
from deploy.run.result import Result
from deploy.scenario.errors import ScenarioError
from deploy.scenario.plan import Plan
from protocol.keyed_random import keyed_random
from protocol.messages import Missed
from tests.deploy.commands.office_floor import murmur
from tests.system.team import small_plan
from worldsim.clock import MOVE, STEP

MURMUR = [sys.executable, "-m", "deploy.commands.main"]


def robot_process(number: int) -> psutil.Process:
    """The process of a robot of the run that this process has started."""
    family = psutil.Process().children(recursive=True)
    return next(found for found in family if found.cmdline()[:1] == [f"murmur r{number}"])


def stopping(number: int, seconds: float, at: int) -> Callable[[Plan, Records], object]:
    """Watch a run, and stop a robot's process for some seconds once the run has reached a step."""
    timers: list[threading.Timer] = []

    def watch(_: Plan, records: Records) -> None:
        if records.step >= at and not timers:
            process = robot_process(number)
            process.suspend()
            timers.append(threading.Timer(seconds, resume, (process,)))
            timers[0].start()

    def resume(process: psutil.Process) -> None:
        with suppress(psutil.NoSuchProcess):
            process.resume()

    return watch


def replay(directory: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*MURMUR, "replay", str(directory)], check=False, capture_output=True, text=True, timeout=300
    )


def missed_by(result: Result, robot: int) -> list[int]:
    """The steps that a robot missed."""
    return [
        each.step for each in result.records.missed if each.phase in (STEP, MOVE) and robot in each.robots
    ]


def test_a_stopped_robot_misses_steps_and_continues_and_the_run_repeats(tmp_path: Path) -> None:
    settings: dict[str, Any] = {"map": "em", "robots": 3, "clock": "wall", "step_s": 0.1, "steps": 30}
    out = tmp_path / "run"
    result = explore(out=out, watch=stopping(1, 0.8, at=8), **settings)
    assert result.exit_code in (0, 1)
    assert len(missed_by(result, 1)) >= 3
    assert result.records.statuses[1][-1].step > max(missed_by(result, 1)[:3])
    assert result.summary["missed_steps_by_robot"][1] == len(missed_by(result, 1))
    assert result.summary["missed_steps"] == sum(result.summary["missed_steps_by_robot"])
    page = write_report(out).read_text(encoding="utf-8")
    assert "steps that robots missed" in page
    missed = result.summary["missed_steps_by_robot"]  # on a busy machine, others may miss more than robot 1
    assert f"most by robot {missed.index(max(missed))}: {max(missed)}" in page
    assert not result.records.protocol_errors.texts
    assert any("missed steps: " in line for line in summary_lines(result.summary, out, noisy=False))
    again = murmur("replay", str(out))
    assert again.exit_code == 0, again.stdout + again.stderr
    assert "Replay matches" in again.stdout
    (out / MISSED).unlink()
    refused = murmur("replay", str(out))
    assert refused.exit_code == 2
    assert "missed.parquet: is missing" in refused.stderr


@pytest.mark.long
def test_eight_robots_explore_by_the_wall_clock_as_by_the_barrier_and_repeat(tmp_path: Path) -> None:
    for seed in range(5):
        settings: dict[str, Any] = {"map": "office", "robots": 8, "seed": seed}
        barrier = explore(keep=False, bus="memory", **settings)
        out = tmp_path / f"run-{seed}"
        result = explore(out=out, clock="wall", step_s=0.2, **settings)
        print(seed, result.summary["steps"], barrier.summary["steps"], result.summary["missed_steps"])
        assert result.exit_code == 0
        assert result.summary["steps"] <= 1.05 * barrier.summary["steps"]
        again = replay(out)
        assert again.returncode == 0, again.stdout + again.stderr


@pytest.mark.long
def test_a_robot_that_is_stopped_for_two_seconds_misses_ten_steps(tmp_path: Path) -> None:
    out = tmp_path / "run"
    settings: dict[str, Any] = {"map": "office", "robots": 8, "clock": "wall", "step_s": 0.2, "steps": 90}
    result = explore(out=out, watch=stopping(3, 2.0, at=40), **settings)
    missed = missed_by(result, 3)
    assert 10 <= len(missed) <= 12
    assert result.records.statuses[3][-1].step == 90
    again = replay(out)
    assert again.returncode == 0, again.stdout + again.stderr


def random_record(seed: int, steps: int, robots: int) -> list[Missed]:
    """Robots that miss random phases of random steps, as a clock could record it."""
    draw = keyed_random(seed, "missed", 0)
    record = []
    for step in range(1, steps):
        phases = [phase for phase in ("offers", "answers", "data") if draw.random() < 0.1]
        record += [Missed(step, each, int(draw.integers(2)), [int(draw.integers(robots))]) for each in phases]
        if draw.random() < 0.2:
            robot = int(draw.integers(robots))
            record += [Missed(step, MOVE, 0, [robot]), Missed(step + 1, STEP, 0, [robot])]
    return record


RADIOS: dict[str, dict[str, Any]] = {
    "gossip": {"map_encoding": "predictive", "bandwidth": 100},
    "handshakes": {"bandwidth": 400},
    "lossy": {"bandwidth": 400, "radio": {"loss": 0.2}},
}


@pytest.mark.parametrize("radio", list(RADIOS))
def test_a_run_in_memory_repeats_any_record(radio: str) -> None:
    plan = small_plan(robots=4, steps=40, clock="wall", step_s=0.1, **RADIOS[radio])
    record = random_record(1, 40, 4)
    records = MemoryRun(plan, missed=record).complete()
    assert not records.protocol_errors.texts
    assert not records.lost
    assert records.world[-1].step == 40
    repeated = MemoryRun(plan, missed=records.missed).complete()
    assert repeated.missed == records.missed
    assert digest(repeated) == digest(records)
    assert digest(records) != digest(MemoryRun(plan, missed=[]).complete())


def busy_record(steps: int, robots: int) -> list[Missed]:
    """Half of the robots are late in each step, and some take no part in it."""
    draw = keyed_random(2, "missed", 1)
    record = []
    for step in range(3, steps):
        late = draw.random((2, robots)) < 0.5
        absent = np.flatnonzero(late[0] & late[1]).tolist()
        for phase, which in ((STEP, absent), (MOVE, np.flatnonzero(late[0] & ~late[1]).tolist())):
            record += [Missed(step, phase, 0, which)] if which else []
    return record


@pytest.mark.parametrize(
    "settings",
    [
        {"robots": 1},
        {"robots": 6},
        {"robots": 3, "fault": [{"step": step, "robot": step % 3, "kind": "restart"} for step in (8, 9, 22)]},
        {"robots": 4, "change": [{"step": 9, "range": 2.0}, {"step": 20, "bandwidth": 50}]},
    ],
    ids=["one-robot", "six-robots", "restarts", "changes"],
)
def test_runs_in_which_most_robots_are_late_repeat(settings: dict[str, Any]) -> None:
    plan = small_plan(steps=40, clock="wall", step_s=0.1, **settings)
    records = MemoryRun(plan, missed=busy_record(40, settings["robots"])).complete()
    assert not records.protocol_errors.texts
    assert not records.lost
    assert records.world[-1].step == 40
    repeated = MemoryRun(plan, missed=records.missed).complete()
    assert repeated.missed == records.missed
    assert digest(repeated) == digest(records)


def test_a_robot_that_misses_steps_neither_moves_nor_sends_in_them() -> None:
    plan = small_plan(robots=2, steps=12, clock="wall", **RADIOS["gossip"])
    record = [Missed(5, "offers", 0, [1]), Missed(5, MOVE, 0, [1])]
    record += [Missed(step, STEP, 0, [1]) for step in (6, 7, 8)]
    records = MemoryRun(plan, missed=record).complete()
    driven = [report.driven[1] for report in records.world]
    assert len(set(driven[4:9])) == 1
    ledger = records.ledger()
    sent = ledger[(ledger["sender"] == 1) & (ledger["carried"] == 1)]["step"]
    assert not set(sent.tolist()) & {5, 6, 7, 8}
    assert max(sent) >= 9
    assert [status.step for status in records.statuses[1]] == [*range(1, 6), *range(9, 13)]


def test_a_run_by_the_wall_clock_is_not_repeatable_if_a_connection_was_cut() -> None:
    summary = {"reason": "explored", "lost": {}, "reconnected": [[3, 1]]}
    assert why_unrepeatable(summary | {"clock": "barrier"}) == ""
    assert "cut and restored" in why_unrepeatable(summary | {"clock": "wall"})


def test_one_process_cannot_follow_the_wall_clock() -> None:
    with pytest.raises(ScenarioError, match="bus must be 'zenoh'"):
        explore(keep=False, clock="wall", bus="memory")
    with pytest.raises(ScenarioError, match="only with clock = 'wall'"):
        explore(keep=False, step_s=0.2, bus="memory")
    with pytest.raises(ValueError, match="omit the pace"):
        explore(keep=False, clock="wall", pace=3.0)


def test_budgets_of_short_steps_are_saved_for_whole_frames() -> None:
    settings: dict[str, Any] = RADIOS["gossip"] | {"robots": 3, "steps": 60, "bandwidth": 8, "seed": 1}
    plan = small_plan(clock="wall", step_s=0.2, **settings)
    records = MemoryRun(plan, missed=[]).complete()
    ledger = records.ledger()
    sent = np.bincount(ledger["step"], ledger["bytes"] * ledger["carried"])
    assert 8 < max(sent) <= 5 * 8
    assert np.cumsum(sent).max() <= 8 * len(sent) + 5 * 8
    assert summarize(plan, records, 1.0)["over_budget_steps"] == 0
    barrier = MemoryRun(small_plan(**settings)).complete().ledger()
    assert max(np.bincount(barrier["step"], barrier["bytes"] * barrier["carried"])) <= 8
    assert summarize(plan, records, 1.0)["digest"] == digest(
        MemoryRun(plan, missed=records.missed).complete()
    )
