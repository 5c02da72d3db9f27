"""Benchmark of replanning: processor time of the decisions in which a robot chooses a new target.

Each strategy explores a map of 400 x 400 cells once, with 8 robots and raw scans over an unlimited radio, so that all
robots know nearly the whole map. The measurement leaves out decisions in which a robot keeps its target. The baseline
is one cost field over a whole planning grid of the same run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np

from agent.strategies.base import Decision, Situation, Strategy
from agent.strategies.registry import strategies
from agent.strategies.targets import TargetStrategy
from deploy.bench.baselines import optional_module
from deploy.bench.explorations import Cell
from deploy.bench.measurement import Measurement, timed
from deploy.run import in_memory
from deploy.scenario import plan as plans
from deploy.scenario.scenario import Scenario
from protocol.grid import FREE, Grid
from worldsim import generators

ROBOTS = 8
SIDE_M = 40.0
SPEED = 1.0
STEPS = 120
BASELINE_GRIDS = 5
"""Number of planning grids per run on which the baseline is measured."""
GRID_EVERY = 50
"""Every this many decisions, the planning grid is kept for the baseline."""

MEAN_TARGET, P95_TARGET = "at most 5 ms", "at most 15 ms"

WITHOUT_TARGET = ("burgard-optimal", "mtsp", "mtsp-depot")
"""Strategies without a target value, because they search for better assignments or tours in addition."""


def replanning() -> Iterator[Measurement]:
    """Measure the mean and 95th percentile of each strategy."""
    graph = optional_module("skimage.graph", "scikit-image")
    world = generators.make("office", width_m=SIDE_M, height_m=SIDE_M)
    for name, strategy in strategies().items():
        scenario = Scenario(
            robots=ROBOTS, strategy=name, map_encoding="scans", bandwidth="unlimited", speed=SPEED, steps=STEPS,
            bus="memory",
        )  # fmt: skip
        timer = DecisionTimer()
        with timer.attached_to(strategy):
            in_memory.run(plans.make(scenario, world))
        yield from _measurements(name, timer, graph)


def _measurements(name: str, timer: DecisionTimer, graph: Any) -> Iterator[Measurement]:
    chosen = np.linspace(0, len(timer.grids) - 1, BASELINE_GRIDS).astype(int).tolist()
    field = float(np.median([_cost_field_ms(graph, *timer.grids[number]) for number in chosen]))
    baseline = "one cost field by skimage's MCP_Geometric"
    for what, value, target in (
        ("mean", float(np.mean(timer.spent_ms)), MEAN_TARGET),
        ("95th percentile", float(np.percentile(timer.spent_ms, 95)), P95_TARGET),
    ):
        shown = "" if name in WITHOUT_TARGET else target
        yield Measurement(f"{name}, {what}", "ms", value, baseline, value / field, target=shown)


def _cost_field_ms(graph: Any, grid: Grid, cell: Cell) -> float:
    prices = np.where(grid == FREE, 1.0, -1.0)
    return timed(lambda: graph.MCP_Geometric(prices).find_costs([cell[::-1]]))[1]


class DecisionTimer:
    """Measures the processor time of decisions in which a robot chooses a target.

    Attributes
    ----------
    spent_ms : list of float
        Milliseconds of each such decision.
    grids : list of (grid, cell)
        Planning grid and robot cell at every `GRID_EVERY`-th of them.
    """

    def __init__(self) -> None:
        self.spent_ms: list[float] = []
        self.grids: list[tuple[Grid, Cell]] = []
        self._replans = False

    @contextmanager
    def attached_to(self, strategy: type[Strategy]) -> Iterator[None]:
        """Measure all robots of one strategy while the context is open."""
        replans_always = not issubclass(strategy, TargetStrategy)
        decide, select = strategy.decide, getattr(strategy, "select", None)

        def timed_decide(robot: Strategy, situation: Situation) -> Decision:
            self._replans = replans_always
            decision, spent = timed(partial(decide, robot, situation))
            if self._replans:
                if len(self.spent_ms) % GRID_EVERY == 0:
                    self.grids.append((situation.grid.copy(), situation.here))
                self.spent_ms.append(spent)
            return decision

        def noted_select(*arguments: Any) -> Any:
            self._replans = True
            assert select is not None
            return select(*arguments)

        with _replaced(strategy, "decide", timed_decide):
            if replans_always:
                yield
            else:
                with _replaced(strategy, "select", noted_select):
                    yield


@contextmanager
def _replaced(kind: type, name: str, method: Callable[..., Any]) -> Iterator[None]:
    """Temporarily replace a method of a class, defined there or inherited."""
    own = vars(kind).get(name)
    setattr(kind, name, method)
    try:
        yield
    finally:
        if own is None:
            delattr(kind, name)
        else:
            setattr(kind, name, own)
