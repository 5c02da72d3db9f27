"""Runs of many robots, or of large maps, as processes: each robot's maps arrive at the end."""

from __future__ import annotations

from typing import Any

import pytest

from deploy.run import launch
from deploy.run.rendezvous import by_certificates, on_loopback
from tests.system.team import small_plan

SIZES = [
    (24, 1000, {}),
    (40, 600, {}),
    (8, 1448, {}),
    (8, 2048, {}),
    (64, 2048, {"map_encoding": "none"}),
    (256, 600, {"map_encoding": "predictive", "dissemination": "gossip"}),
]
"""Robots, cells per side of the map, further settings."""


def run(robots: int, side: int, more: dict[str, Any], *, tls: bool) -> launch.Outcome:
    """Two steps with passwords, or over TLS."""
    settings = {"strategy": "greedy", "map_encoding": "predictive", "steps": 2} | more
    plan = small_plan(side_m=side / 10, robots=robots, **settings)
    assert plan.map.cells.shape == (side, side)
    rendezvous = by_certificates("127.0.0.1", None, robots) if tls else on_loopback(robots)
    return launch.run(plan, None, rendezvous=rendezvous)


def check(outcome: launch.Outcome, robots: int) -> None:
    assert outcome.deaths == {}
    assert outcome.records.lost == {}
    assert sorted(outcome.records.own) == sorted(outcome.records.planning) == list(range(robots))
    assert outcome.records.protocol_errors.texts == []


def test_each_map_of_a_run_arrives() -> None:
    check(run(6, 800, {}, tls=False), 6)


@pytest.mark.long
@pytest.mark.parametrize("tls", [False, True], ids=["passwords", "tls"])
@pytest.mark.parametrize("robots, side, more", SIZES, ids=[f"{size[0]}-{size[1]}" for size in SIZES])
def test_each_map_of_a_large_run_arrives(robots: int, side: int, more: dict[str, Any], tls: bool) -> None:
    check(run(robots, side, more, tls=tls), robots)
