"""Run a scenario step by step in this process: ``for step in steps(robots=3): ...``."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from agent.outline.polygons import Polygons
from deploy.record import run_directory
from deploy.run import memory
from deploy.run.control import change, kill
from deploy.run.exploration import scenario_of
from deploy.run.in_memory import MemoryRun
from deploy.run.launch import Outcome
from deploy.run.result import Result, conclude, frame
from deploy.scenario import plan as plans
from deploy.scenario.scenario import Scenario
from netshaper.ledger import ROW
from protocol.grid import Grid
from worldsim.maps import to_world

if TYPE_CHECKING:
    import polars as pl


@dataclass(frozen=True, eq=False, repr=False)
class RobotState:
    """A robot at the end of a step."""

    number: int
    """From 0."""
    x: float
    y: float
    """True position in meters, in the map's frame, y up."""
    heading: float
    """Degrees, a full turn is 360; 0 points along x, 90 along -y."""
    cell: tuple[int, int]
    """Its cell (x, y), row 0 on top: ``grid[y, x]``."""
    driven: float
    """Distance driven since the start, in meters."""
    own: Grid
    """Cells that it has seen itself, uint8 of shape (h, w): 0 unknown, 1 free, 2 occupied. A view of the robot's array,
    which changes with the next step: copy it to keep it.
    """
    planning: Grid
    """`own` merged with the maps received from teammates; the robot plans on it. Copy it to keep it."""
    target: tuple[int, int] | None
    """Its target cell (x, y)."""
    status: str
    """Its current activity."""
    polygons: Mapping[int, Polygons]
    """The outlines of each robot's map as this robot holds them, its own included (`agent.outline.polygons`); empty
    with other map encodings.
    """

    def __repr__(self) -> str:
        return f"<robot {self.number} at ({self.x:.2f}, {self.y:.2f}) m, {self.status or 'under way'}>"


@dataclass(frozen=True, eq=False, repr=False)
class Step:
    """The state of a run at the end of a step, valid until the next step is requested."""

    number: int
    """From 1; one step is one second."""
    explored: float
    """Fraction of the reachable cells that the team has seen, 0 to 1."""
    carried: int
    """Bytes sent in this step."""
    robots: dict[int, RobotState]
    """The robots in the world, by number."""
    truth: Grid
    """The world, uint8 of shape (h, w)."""
    _rows: bytes

    @cached_property
    def traffic(self) -> pl.DataFrame:
        """One row per frame and kind of packet of this step, with the columns of ``ledger.parquet``."""
        return frame(run_directory.ledger_table(np.frombuffer(self._rows, ROW)))

    @property
    def maps(self) -> dict[str | int, Grid]:
        """Copies of the maps, as `Result.maps` has them: ``"truth"``, ``"team"``, planning grids by number."""
        named: dict[str | int, Grid] = {"truth": self.truth}
        if self.robots:
            named["team"] = np.maximum.reduce([robot.own for robot in self.robots.values()])
        return named | {number: robot.planning.copy() for number, robot in self.robots.items()}

    def __repr__(self) -> str:
        return (
            f"<step {self.number}: {100 * self.explored:.1f} % explored, {len(self.robots)} robots, "
            f"{self.carried} bytes>"
        )


class Steps:
    """A run in progress: iterate over its steps, to any step or to the end. No files are written.

    It uses no process, thread or file, so it need not be closed. ``with steps(...) as run:`` ends it with the block.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.plan = plans.make(scenario)
        """The plan, with scenario and map."""
        memory.check(self.plan)
        self._began = time.perf_counter()
        self._result: Result | None = None
        self._run = MemoryRun(self.plan)
        self._reported = 0
        """Number of the relay's reports that previous steps have returned."""
        self._steps: Iterator[int] = self._run.steps()

    def __iter__(self) -> Iterator[Step]:
        return self

    def __next__(self) -> Step:
        number = next(self._steps, None) or next(self._steps, None)  # 0: the first step is opened
        if number is not None:
            return self._state(number)
        if self._result is None and self._run.records.end is not None:
            seconds = time.perf_counter() - self._began
            self._result = conclude(self.plan, Outcome(self._run.records, {}), None, seconds)
        raise StopIteration

    def kill(self, robot: int) -> None:
        """Kill a robot at the start of the step after the next one, which the world has opened already.

        Raises ValueError if the robot does not exist.
        """
        self._run.ask(kill(self.plan.scenario, robot))

    def change(self, *, bandwidth: int | str | None = None, range: float | str | None = None) -> None:
        """Change the radio from the step after the next one on; values as in a scenario.

        Raises ScenarioError if a value is invalid.
        """
        self._run.ask(change(self.plan.scenario, self.plan.map.diagonal_m, bandwidth=bandwidth, range=range))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the iteration; the run does not continue."""
        self._steps = iter(())

    @property
    def result(self) -> Result:
        """The result as `explore` returns it, after the last step.

        Raises RuntimeError if the run is not over.
        """
        if self._result is None:
            raise RuntimeError("the run has not ended: iterate over all steps first")
        return self._result

    def __repr__(self) -> str:
        return f"<Steps of {self.plan.scenario.robots} robots on {self.plan.map.name}>"

    def _state(self, number: int) -> Step:
        records, resolution = self._run.records, self.plan.map.resolution
        report = next(each for each in reversed(records.world) if each.step == number)
        robots = {}
        for index, x_mm, y_mm, heading in report.pose_rows.tolist():
            robot = self._run.agents[index].robot
            if robot is None:
                continue
            x_cell, y_cell = x_mm / 1000 / resolution, y_mm / 1000 / resolution
            x, y = to_world(self.plan.map, x_cell, y_cell)
            robots[index] = RobotState(
                index, x, y, heading / 10, (round(x_cell), round(y_cell)), report.driven[index] / 1000,
                _unwritable(robot.own), _unwritable(robot.planning), robot.target, robot.status, robot.polygons,
            )  # fmt: skip
        rows = b"".join(records.rows[self._reported :])
        self._reported = len(records.rows)
        return Step(
            number, report.seen / report.reachable, records.carried, robots, self.plan.map.cells, rows
        )


def steps(scenario: Scenario | Path | str | None = None, **settings: Any) -> Steps:
    """Start a run in this process that advances with each step that the caller requests.

    `scenario` and `settings` are those of `explore`: ``steps(robots=5, bandwidth=1000)``. The bus is always ``memory``.
    The returned iterator yields a `Step` after each step, and has the `result` at the end: with the digest that
    `explore` gives.

    Raises ScenarioError if the scenario cannot be run.

    Examples
    --------
    >>> with steps(map="em", robots=2, steps=50) as run:
    ...     for step in run:
    ...         if step.explored > 0.5:
    ...             break
    >>> step
    <step 33: 50.1 % explored, 2 robots, 22 bytes>
    """
    return Steps(scenario_of(scenario, {**settings, "bus": "memory"}))


def _unwritable(grid: Grid) -> Grid:
    view = grid.view()
    view.flags.writeable = False
    return view
