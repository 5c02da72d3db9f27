"""Runs in one process leave no objects behind."""

from __future__ import annotations

import gc
import weakref

import pytest

from deploy.run.in_memory import MemoryRun
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
    gone = weakref.ref(under_way), weakref.ref(under_way.agents[0].robot)
    gc.disable()
    try:
        del under_way
        assert [ref() for ref in gone] == [None, None]
    finally:
        gc.enable()
