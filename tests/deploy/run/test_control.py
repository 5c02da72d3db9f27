"""Live control: requests take effect and become part of the scenario, so that the run can be repeated."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deploy.record.records import Records
from deploy.run.control import Control
from deploy.run.exploration import explore
from deploy.run.result import Result
from deploy.run.stepwise import steps
from deploy.scenario.errors import ScenarioError
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import load, parse

SETTINGS = {"map": "em", "robots": 3, "range": "30%", "bandwidth": 600, "steps": 60, "bus": "memory"}


def controlled_run(**more: Any) -> Result:
    """Return a run in which a robot is killed and the radio changes twice."""
    with steps(parse(SETTINGS | more)) as run:
        for step in run:
            if step.number == 10:
                run.change(bandwidth=100, range=4)
            elif step.number == 20:
                run.kill(1)
            elif step.number == 30:
                run.change(bandwidth="unlimited")
    return run.result


def carried(result: Result) -> np.ndarray[Any, Any]:
    ledger = result.records.ledger()
    return np.bincount(ledger["step"], ledger["bytes"] * ledger["carried"], minlength=61)


def test_requests_take_effect_and_enter_the_scenario_with_their_steps() -> None:
    result = controlled_run()
    scenario = result.plan.scenario
    assert [(each.step, each.bandwidth, each.range) for each in scenario.change] == [
        (12, 100, "4.0"),
        (32, "unlimited", None),
    ]
    assert [(each.step, each.robot, each.kind) for each in scenario.fault] == [(22, 1, "kill")]
    load = carried(result)
    assert load[1:12].max() > 100 >= load[12:32].max()
    assert result.summary["over_budget_steps"] == 0
    assert result.summary["lost"] == {}
    assert 1 not in result.records.planning


@pytest.mark.parametrize(
    "more",
    [
        pytest.param({}, marks=pytest.mark.long),
        pytest.param({"dissemination": "gossip"}, marks=pytest.mark.long),
        {"radio": {"loss": 0.1}},
    ],
)
def test_controlled_run_repeats_from_its_scenario(more: dict[str, Any]) -> None:
    result = controlled_run(**more)
    again = explore(parse(result.plan.scenario.model_dump()), keep=False)
    assert again.summary["digest"] == result.summary["digest"]
    assert again.plan == result.plan or again.plan.scenario == result.plan.scenario
    assert result.plan.scenario.change and result.plan.scenario.fault


@pytest.mark.parametrize("later", ["kill", "death", "stop", "restart"])
def test_requests_replace_scheduled_faults_and_changes_that_they_contradict(later: str) -> None:
    scheduled = {
        "change": [{"step": 12, "bandwidth": 300}],
        "fault": [{"step": 30, "robot": 1, "kind": later}],
        "steps": 35,
    }
    with steps(parse(SETTINGS | scheduled)) as run:
        for step in run:
            if step.number == 10:
                run.change(bandwidth=50)
                run.change(bandwidth=100, range=4)
                run.kill(1)
    written = parse(run.result.plan.scenario.model_dump())
    assert [(each.step, each.bandwidth, each.range) for each in written.change] == [(12, 100, "4.0")]
    assert [each.kind for each in written.fault] == (["kill", "restart"] if later == "restart" else ["kill"])
    assert explore(written, keep=False).summary["digest"] == run.result.summary["digest"]


@pytest.mark.parametrize("wider", ["unlimited", pytest.param(5000, marks=pytest.mark.long)])
def test_robots_use_a_higher_bandwidth_and_none_is_lost(wider: str | int) -> None:
    change = [{"step": 20, "bandwidth": wider}]
    settings = {"map_encoding": "scans", "dissemination": "gossip", "bandwidth": 6, "change": change}
    result = explore(parse(SETTINGS | settings), keep=False)
    assert result.summary["lost"] == {}
    assert carried(result)[:20].max() <= 6 and carried(result)[20:].max() > 200


def test_pause_holds_the_run_and_requests_during_it_are_kept(tmp_path: Path) -> None:
    control, seen = Control(), []

    def watch(plan: Plan, records: Records) -> None:
        seen.append(records.step)
        if records.step == 5:
            control.pause()
        if records.step == 8:
            control.kill(0)
            control.resume()

    def go_on() -> None:
        while not control.paused:
            time.sleep(0.01)
        time.sleep(0.3)
        held.append(len(seen))
        time.sleep(0.2)
        held.append(len(seen))
        control.step(3)

    held: list[int] = []
    other = threading.Thread(target=go_on)
    other.start()
    result = explore(parse(SETTINGS), out=tmp_path / "run", watch=watch, control=control)
    other.join()
    assert held[0] == held[1]
    assert seen[held[0] - 1] in (5, 6)
    written = load(tmp_path / "run" / "scenario.toml", {})
    assert [fault.robot for fault in written.fault] == [0]
    assert explore(written, keep=False).summary["digest"] == result.summary["digest"]


def test_invalid_requests_raise_and_change_nothing() -> None:
    control = Control()
    with pytest.raises(ValueError, match="the run has not started"):
        control.kill(0)
    with pytest.raises(ValueError, match=r"speed = 0.1: must be 0.5 steps per second or more"):
        control.set_speed(0.1)
    with steps(parse(SETTINGS)) as run:
        with pytest.raises(ValueError, match="unknown robot 3; the last one is 2"):
            run.kill(3)
        with pytest.raises(ScenarioError, match=r"bandwidth = -1"):
            run.change(bandwidth=-1)
        with pytest.raises(ScenarioError, match=r"range"):
            run.change(range="near")
        with pytest.raises(ScenarioError, match="changes neither bandwidth nor range"):
            run.change()


def test_changes_in_a_scenario_are_validated() -> None:
    with pytest.raises(ScenarioError, match=r"change.*step"):
        parse(SETTINGS | {"change": [{"step": 0, "bandwidth": 3}]})
    with pytest.raises(ScenarioError, match=r"must be tables, \[\[change\]\], of step, bandwidth, range"):
        parse(SETTINGS | {"change": 3})
    with pytest.raises(
        ScenarioError, match=r"2 tables \[\[change\]\] set bandwidth at step 4; keep one of them"
    ):
        parse(SETTINGS | {"change": [{"step": 4, "bandwidth": 3}, {"step": 4, "bandwidth": 30, "range": 2}]})
    parse(SETTINGS | {"change": [{"step": 4, "bandwidth": 3}, {"step": 4, "range": 2}]})
    with pytest.raises(ScenarioError, match=r"a share of the bandwidth, which must be limited"):
        change = {"step": 4, "bandwidth": "unlimited"}
        parse(SETTINGS | {"radio": {"duty_cycle": 0.5}, "change": [change]})
