"""Bench of replanning: the cost of a decision in the steps in which a robot chooses a new target.

Every strategy explores once with 8 robots on a planning grid of 400 x 400 cells, with raw scans over an
unlimited radio, so that all robots know nearly the whole map. Processor time of each `decide` is measured
during the run; decisions in which a robot only continues driving are left out. The yardstick is one cost
field of a whole planning grid, on grids of the same run.
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
from deploy.bench.explorations import Cell
from deploy.bench.handshakes import timed
from deploy.bench.ratios import Figure
from deploy.bench.yardsticks import yardstick
from deploy.run import in_memory
from deploy.scenario import plan as plans
from deploy.scenario.scenario import Scenario
from protocol.grid import FREE, Grid
from worldsim import generators

ROBOTS = 8
SIDE_M = 40.0
SPEED = 1.0
STEPS = 120
YARDSTICKS = 5
"""Planning grids of each run on which the yardstick is measured."""

MEAN_AIM, P95_AIM = "at most 5 ms", "at most 15 ms"

ASIDE = ("burgard-optimal", "mtsp", "mtsp-depot")
"""Strategies without an aim: they search for better assignments or tours on top."""


def replanning() -> Iterator[Figure]:
    """Mean and 95th percentile of every strategy."""
    graph = yardstick("skimage.graph", "scikit-image")
    world = generators.make("office", width_m=SIDE_M, height_m=SIDE_M)
    for name, kind in strategies().items():
        scenario = Scenario(
            robots=ROBOTS, strategy=name, map_encoding="scans", bandwidth="unlimited", speed=SPEED, steps=STEPS,
            bus="memory",
        )  # fmt: skip
        watch = Watch()
        with watch.over(kind):
            in_memory.run(plans.make(scenario, world))
        yield from watch.figures(name, graph)


class Watch:
    """Measures the processor time of decisions in which a robot chooses a target."""

    def __init__(self) -> None:
        self.spent: list[float] = []
        """Milliseconds of each decision that replans."""
        self.seen: list[tuple[Grid, Cell]] = []
        """The planning grid, and the robot's cell, of some of them."""
        self._chooses = False

    @contextmanager
    def over(self, kind: type[Strategy]) -> Iterator[None]:
        """Watch all robots of one strategy."""
        replans_always = not issubclass(kind, TargetStrategy)
        plain = kind.decide

        def decide(robot: Strategy, situation: Situation) -> Decision:
            self._chooses = replans_always
            decision, spent = timed(partial(plain, robot, situation))
            if self._chooses:
                if len(self.spent) % 50 == 0:
                    self.seen.append((situation.grid.copy(), situation.here))
                self.spent.append(spent)
            return decision

        with _replaced(kind, "decide", decide):
            if replans_always:
                yield
            else:
                with _replaced(kind, "select", self._noting(kind.select)):  # type: ignore[attr-defined]
                    yield

    def _noting(self, plain: Callable[..., Any]) -> Callable[..., Any]:
        """Note that a robot selects a target."""

        def select(*situation: Any) -> Any:
            self._chooses = True
            return plain(*situation)

        return select

    def figures(self, name: str, graph: Any) -> Iterator[Figure]:
        """Mean and 95th percentile against the yardstick's median."""
        some = np.linspace(0, len(self.seen) - 1, YARDSTICKS).astype(int).tolist()
        field = float(np.median([_one_field(graph, *self.seen[number]) for number in some]))
        mean, p95 = float(np.mean(self.spent)), float(np.percentile(self.spent, 95))
        of_all = name not in ASIDE
        book = "one cost field by skimage's MCP_Geometric"
        yield Figure(f"{name}, mean", "ms", mean, book, mean / field, aim=MEAN_AIM if of_all else "")
        yield Figure(f"{name}, 95th percentile", "ms", p95, book, p95 / field, aim=P95_AIM if of_all else "")


def _one_field(graph: Any, grid: Grid, cell: Cell) -> float:
    prices = np.where(grid == FREE, 1.0, -1.0)
    return timed(lambda: graph.MCP_Geometric(prices).find_costs([cell[::-1]]))[1]


@contextmanager
def _replaced(kind: type, name: str, method: Callable[..., Any]) -> Iterator[None]:
    """Temporarily replace a method of a class, its own or an inherited one."""
    own = vars(kind).get(name)
    setattr(kind, name, method)
    try:
        yield
    finally:
        if own is None:
            delattr(kind, name)
        else:
            setattr(kind, name, own)
