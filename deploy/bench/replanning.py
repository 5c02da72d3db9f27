"""Benchmark of replanning: processor time of the decisions in which a robot chooses a new target.

Each strategy explores a map of 400 x 400 cells once, with 8 robots and raw scans over an unlimited radio, so that all
robots know nearly the whole map. The measurement leaves out decisions in which a robot keeps its target. The baseline
is one cost field over the whole planning grid of the last decision.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any
from unittest.mock import patch

import numpy as np

from agent.strategies.base import Decision, Situation, Strategy
from agent.strategies.registry import strategies
from agent.strategies.targets import TargetStrategy
from deploy.bench.baselines import skimage_costs_ms
from deploy.bench.explorations import office
from deploy.bench.measurement import Measurement, timed
from deploy.run.in_memory import MemoryRun
from deploy.scenario import plan as plans
from deploy.scenario.scenario import Scenario
from protocol.grid import Cell, Grid
from protocol.packages import require

ROBOTS = 8
SIDE_M = 40.0
SPEED = 1.0
STEPS = 120
REPEATS = 5
"""Number of times that the baseline is measured."""


def replanning() -> Iterator[Measurement]:
    """Measure the mean and 95th percentile of each strategy."""
    require("skimage", "bench", "the benchmark needs")
    from skimage import graph  # noqa: PLC0415

    world = office(SIDE_M)
    baseline = "one cost field by skimage's MCP_Geometric"
    for name, strategy in strategies().items():
        scenario = Scenario(
            robots=ROBOTS, strategy=name, map_encoding="scans", bandwidth="unlimited", speed=SPEED, steps=STEPS,
            bus="memory",
        )  # fmt: skip
        timer = DecisionTimer()
        with timer.attached_to(strategy):
            MemoryRun(plans.make(scenario, world)).complete()
        field_ms = float(np.median([skimage_costs_ms(graph, *timer.last) for _ in range(REPEATS)]))
        mean, late = float(np.mean(timer.spent_ms)), float(np.percentile(timer.spent_ms, 95))
        yield Measurement(f"{name}, mean", "ms", mean, baseline, mean / field_ms)
        yield Measurement(f"{name}, 95th percentile", "ms", late, baseline, late / field_ms)


class DecisionTimer:
    """Measures the processor time of decisions in which a robot chooses a target."""

    last: tuple[Grid, Cell]
    """Planning grid and robot cell of the last one."""

    def __init__(self) -> None:
        self.spent_ms: list[float] = []
        """Milliseconds of each such decision."""
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
                self.last = situation.grid, situation.here
                self.spent_ms.append(spent)
            return decision

        def noted_select(*arguments: Any) -> Any:
            self._replans = True
            assert select is not None
            return select(*arguments)

        with ExitStack() as patches:
            patches.enter_context(patch.object(strategy, "decide", timed_decide))
            if not replans_always:
                patches.enter_context(patch.object(strategy, "select", noted_select))
            yield
