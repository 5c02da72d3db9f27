"""Robots whose TCP connections to the hub are cut, with one robot behind a proxy: each continues where it was."""

from __future__ import annotations

import pytest

from deploy.chaos.cut_connections import Cut, Cutter, proxied
from deploy.record.records import Records
from deploy.record.summary import digest, summarize
from deploy.run import in_memory, launch
from deploy.run.rendezvous import on_loopback
from deploy.scenario.plan import Plan
from netshaper.process import DISCONNECTED
from tests.system.team import small_plan

CUT = 1
"""The robot whose connection is cut."""
PACE = 40.0


def run(
    plan: Plan, cuts: list[int], pace: float | None = PACE, *, outage_s: float = 0.0, reset: bool = False
) -> launch.Outcome:
    """Run a plan, and cut the connection of one robot during each of the steps `cuts`."""
    with proxied(on_loopback(plan.scenario.robots), [CUT]) as (rendezvous, proxies):
        cutter = Cutter([Cut(step, CUT, reset) for step in cuts], proxies, outage_s)
        with cutter.running():
            return launch.run(plan, None, cutter.watch, rendezvous=rendezvous, pace=pace)


@pytest.fixture(scope="module")
def plan() -> Plan:
    return small_plan(robots=3, map_encoding="predictive", bandwidth=1000)


def check_undisturbed(plan: Plan, records: Records, cuts: int) -> None:
    assert [robot for _, robot in records.reconnected] == cuts * [CUT]
    assert records.lost == {}
    assert records.returned == []
    assert records.protocol_errors.texts == []
    assert digest(records) == digest(in_memory.MemoryRun(plan).complete())


@pytest.mark.parametrize(("cuts", "reset"), [([12], False), ([8, 20, 30], False), ([12, 25], True)])
def test_a_robot_continues_after_its_connection_was_cut(plan: Plan, cuts: list[int], reset: bool) -> None:
    outcome = run(plan, cuts, reset=reset)
    assert outcome.deaths == {}
    check_undisturbed(plan, outcome.records, len(cuts))
    summary = summarize(plan, outcome.records, 1.0)
    assert [robot for _, robot in summary["reconnected"]] == len(cuts) * [CUT]


@pytest.mark.parametrize("reset", [False, True])
def test_all_robots_continue_after_the_relay_s_link_was_cut(plan: Plan, reset: bool) -> None:
    robots = range(plan.scenario.robots)
    with proxied(on_loopback(len(robots)), robots) as (rendezvous, proxies):
        cutter = Cutter([Cut(12, robot, reset) for robot in robots], proxies)
        with cutter.running():
            records = launch.run(plan, None, cutter.watch, rendezvous=rendezvous, pace=PACE).records
    assert sorted(robot for _, robot in records.reconnected) == list(robots)
    assert records.lost == {}
    assert digest(records) == digest(in_memory.MemoryRun(plan).complete())


def test_a_robot_continues_after_an_outage(plan: Plan) -> None:
    check_undisturbed(plan, run(plan, [12], outage_s=1.5).records, 1)


def test_a_robot_that_stays_away_is_lost_and_the_others_continue(plan: Plan) -> None:
    records = run(plan, [12], outage_s=6.0).records
    assert records.lost == {CUT: DISCONNECTED}
    assert records.returned == []
    assert records.end is not None
    assert records.end.reason == "explored"


@pytest.mark.long
@pytest.mark.parametrize("seed", range(20))
def test_a_robot_continues_whenever_its_connection_is_cut(seed: int) -> None:
    plan = small_plan(side_m=20.0, robots=4, map_encoding="polygons", bandwidth=500, seed=seed)
    outcome = run(plan, [3 + seed, 20 + 2 * seed], pace=None, reset=seed % 2 == 1)
    assert 1 <= len(outcome.records.reconnected) <= 2
    check_undisturbed(plan, outcome.records, len(outcome.records.reconnected))
