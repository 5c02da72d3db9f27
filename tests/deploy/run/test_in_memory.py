"""Runs in one process leave no objects behind, and may wait for their caller."""

from __future__ import annotations

import gc
import weakref

import pytest

from deploy.run.in_memory import GARBAGE, MemoryRun
from deploy.scenario import plan as plans
from murmur import Scenario


@pytest.mark.parametrize(
    ("map_encoding", "dissemination", "strategy"),
    [("polygons", "backoff", "meier"), ("scans", "gossip", "burgard"), ("predictive", "gossip", "repairmen")],
)
def test_a_run_without_references_is_freed_at_once(
    map_encoding: str, dissemination: str, strategy: str
) -> None:
    # A sweep makes thousands of runs in one process, and memory in reference cycles is freed late.
    fault = [{"kind": "restart", "robot": 1, "step": 3}]
    scenario = Scenario(
        robots=2,
        map_encoding=map_encoding,
        dissemination=dissemination,
        strategy=strategy,
        steps=12,
        fault=fault,
    )
    under_way = MemoryRun(plans.make(scenario))
    list(under_way.steps())
    robot = under_way.agents[0].robot
    gone = [weakref.ref(part) for part in (under_way, robot, robot.replication)]
    gc.disable()
    try:
        del under_way, robot
        assert [ref() for ref in gone] == [None, None, None]
    finally:
        gc.enable()


def test_the_garbage_collector_runs_rarely_until_a_run_has_ended() -> None:
    before = gc.get_threshold()
    during: set[int] = set()
    run = MemoryRun(plans.make(Scenario(robots=2, steps=3)))
    run.complete(lambda _: during.add(gc.get_threshold()[0]))
    assert during == {GARBAGE}
    assert gc.get_threshold() == before


def test_held_robots_decide_when_their_caller_lets_them_and_change_nothing() -> None:
    plan = plans.make(Scenario(map="em", robots=3, steps=8, map_options={"resolution": 0.2}))
    held = MemoryRun(plan, held=[0, 2])
    decided = []
    for step in held.steps():
        for number, agent in enumerate(held.agents):
            if agent.situation is not None:
                assert agent.situation.step == step + 1
                decided.append((step + 1, number))
                agent.decide()
    assert decided == [(step, number) for step in range(1, 9) for number in (0, 2)]
    plain = MemoryRun(plan).complete()
    assert [report.poses for report in held.records.world] == [report.poses for report in plain.world]
    assert held.records.rows == plain.rows
    with pytest.raises(RuntimeError, match="does not wait for a decision"):
        held.agents[0].decide()


def test_a_run_waits_for_robots_that_are_held() -> None:
    held = MemoryRun(
        plans.make(Scenario(map="em", robots=2, steps=8, map_options={"resolution": 0.2})), held=[1]
    )
    steps = held.steps()
    assert [next(steps) for _ in range(5)] == [0] * 5
    assert held.records.step == 1
    assert held.agents[0].situation is None
    held.agents[1].decide()
    assert next(steps) == 1
