"""Shipped scenarios that repeat single runs of the papers' figures show what the figures show."""

from __future__ import annotations

from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from deploy.run.in_memory import MemoryRun
from deploy.scenario.plan import make
from deploy.scenario.scenario import load
from protocol.grid import UNKNOWN

pytestmark = pytest.mark.slow

CONTACT_M = 5.0
"""Communication range in Burgard et al., Fig. 11."""


class Shown(NamedTuple):
    """What a run shows."""

    steps: int
    places: NDArray[np.float64]
    """Position of each robot in each step, meters from the upper left corner, shape (steps, robots, 2)."""
    known: NDArray[np.bool_]
    """Free cells of the map that each robot has observed itself, shape (robots, cells)."""


@cache
def shown(name: str, gain_robots: float | None = None, **settings: Any) -> Shown:
    if gain_robots is not None:
        settings["options"] = {"way": "visibility", "gain_robots": gain_robots}
    plan = make(load(Path(name), settings))
    run = MemoryRun(plan)
    records = run.complete()
    assert records.end is not None
    poses = [np.frombuffer(report.poses, "<i4").reshape(-1, 4) for report in records.world]
    grids = [agent.robot.own for agent in run.agents if agent.robot is not None]
    return Shown(
        records.end.step,
        np.array([each[:, 1:3] for each in poses]) / 1000,
        np.array([grid[plan.reachable] != UNKNOWN for grid in grids]),
    )


def apart(run: Shown) -> NDArray[np.float64]:
    """Return the distance of each pair of robots in each step, in meters, shape (steps, pairs)."""
    pairs = combinations(range(run.places.shape[1]), 2)
    return np.stack(
        [np.hypot(*(run.places[:, one] - run.places[:, other]).T) for one, other in pairs], axis=1
    )


@pytest.mark.parametrize("seed", range(3))
def test_burgards_coordinated_robots_spread_out_over_the_building(seed: int) -> None:
    # Fig. 3: "the robots were effectively distributed over the environment".
    run = shown("burgard-fig-3.toml", seed=seed)
    assert apart(run).mean() > 1.2 * apart(shown("burgard-fig-3.toml", seed=seed, strategy="nearest")).mean()
    assert run.known.any(axis=0).all()
    assert run.known.mean(axis=1).max() < 0.9
    assert run.steps < 0.65 * shown("burgard-fig-3.toml", robots=1).steps


def test_without_coordination_one_of_burgards_robots_explores_almost_everything() -> None:
    # Fig. 4: one robot "explores the whole environment on its own"; the other "does not contribute anything".
    run = shown("burgard-fig-4.toml")
    assert run.known[1].mean() > 0.9
    assert (run.known[0] & ~run.known[1]).mean() < 0.1
    assert apart(run).max() < 4.0


def test_coordination_sends_burgards_robots_to_different_rooms_and_saves_time() -> None:
    # Fig. 5: 35 seconds instead of the 49 of Fig. 4.
    run = shown("burgard-fig-5.toml")
    assert all((own & ~other).mean() > 0.2 for own, other in (run.known, run.known[::-1]))
    assert apart(run).max() > 5.0
    assert run.steps <= 0.8 * shown("burgard-fig-4.toml").steps


def test_burgards_robots_lose_contact_and_pairs_meet_again() -> None:
    # Fig. 11: all separate, then two meet while the third is alone, then another pair completes the exploration.
    contacts = [tuple(row) for row in (apart(shown("burgard-fig-11.toml")) <= CONTACT_M).tolist()]
    assert contacts[0] == (True, True, True)
    alone = contacts.index((False, False, False))
    first = next(each for each in contacts[alone:] if any(each))
    assert sum(first) == 1
    later = [each for each in contacts[alone:] if sum(each) == 1 and each != first]
    assert later


def test_the_leader_papers_robots_spread_out_because_they_repel_each_other() -> None:
    # Fig. 2: "the cooperative behavior which brings to spread out the teammates".
    run = shown("leader-fig-2.toml")
    together = shown("leader-fig-2.toml", gain_robots=0)
    assert run.known.any(axis=0).all()
    assert apart(run).mean() > 1.2 * apart(together).mean()
    assert run.steps < together.steps
