"""Find the team size, bandwidth and communication range that a building needs: `murmur size`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import polars as pl

from deploy.scenario.errors import ScenarioError
from deploy.scenario.plan import load_map
from deploy.study import plots
from deploy.study.experiment import first_seeds, listed
from deploy.study.figure_style import DEFAULT, FigureStyle
from deploy.study.paper_tables import write_result
from deploy.study.plots import Plot
from deploy.study.results import PLACE, Row
from deploy.study.runs import Case
from deploy.study.statistics import Interval, interval, share
from deploy.study.sweep import Sweep, of_settings, run
from deploy.study.tables import has_finished, short
from protocol.budget import WORD_FOR_UNLIMITED
from protocol.errors import shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KEYS = ("robots", "bandwidth", "range")

METRICS = ("steps", "map_accuracy", "worst_map_accuracy")
"""Columns of the printed table."""

SEEDS = 5

MIN_MAP_ACCURACY = 0.95


@dataclass(frozen=True)
class Requirements:
    """What a run must meet so that its team or its radio suffices for the building."""

    deadline: int | None = None
    """Maximum number of steps; None: any number."""
    min_map_accuracy: float = MIN_MAP_ACCURACY
    """Minimum share of correct cells on the map of the first robot, or of the worst one (`finish`)."""
    finish: str = "all"
    """Which robots must finish with an accurate map: ``first`` or ``all``."""

    def __post_init__(self) -> None:
        """Raise ScenarioError if no run, or each run, would meet them."""
        deadline, accuracy = self.deadline, self.min_map_accuracy
        if deadline is not None and not deadline >= 1:
            raise ScenarioError(f"deadline = {shown(deadline)}: must be a number of steps, at least 1")
        if not 0 <= accuracy <= 1:
            raise ScenarioError(f"min_map_accuracy = {shown(accuracy)}: must be a share from 0 to 1, as 0.95")

    def accuracy(self, row: Row) -> float:
        """Return the accuracy that counts in a run: that of the worst map, or of the first robot's."""
        return row["worst_map_accuracy" if self.finish == "all" else "map_accuracy"] or 0.0

    def are_met(self, row: Row) -> bool:
        """Return whether a run meets them."""
        in_time = self.deadline is None or row["steps"] <= self.deadline
        return has_finished(row) and in_time and self.accuracy(row) >= self.min_map_accuracy

    def __str__(self) -> str:
        whose = "each robot's map" if self.finish == "all" else "the first robot's map"
        in_time = "" if self.deadline is None else f"within {self.deadline} steps and "
        return f"{in_time}with at least {100 * self.min_map_accuracy:g} % of {whose} correct"


class Option(NamedTuple):
    """A tested team."""

    robots: int
    bandwidth: int | str
    range: str
    met: Interval
    """Share of its runs that met the requirements (Wilson); failed runs did not."""
    steps: Interval
    """Steps of the finished runs."""
    worst_map: float | None
    """Minimum over the finished runs of the accuracy that counts; None if no run has finished."""

    def __str__(self) -> str:
        robots = "1 robot" if self.robots == 1 else f"{self.robots} robots"
        is_word = isinstance(self.bandwidth, str)
        bandwidth = "unlimited bandwidth" if is_word else f"{self.bandwidth} bytes per step"
        reach = self.range if self.range.endswith("%") else f"{self.range} m"
        return f"{robots} with {bandwidth} and a range of {reach}"

    @property
    def time(self) -> str:
        """Mean steps and half of their interval, as text."""
        half = f" ± {self.steps.half:.0f}" if self.steps.n > 1 else ""
        return f"{self.steps.mean:.0f}{half} steps"


@dataclass(frozen=True, eq=False, repr=False)
class Sizing:
    """Tested teams in a building; a notebook shows the answer, curves and table."""

    sweep: Sweep
    options: list[Option]
    """By robots, bandwidth and range, ascending."""
    requirements: Requirements

    @property
    def enough(self) -> Option | None:
        """The smallest team, then bandwidth, then range, of which all runs met the requirements."""
        return next((option for option in self.options if option.met.mean == 1), None)

    @property
    def sentence(self) -> str:
        """The answer as a sentence."""
        building = short(self.sweep.experiment.base["map"])
        goal = str(self.requirements)
        if best := self.enough:
            verb = "explores" if best.robots == 1 else "explore"
            return (
                f"{best} {verb} {building} {goal}: in {best.time}, {best.met.n} of {best.met.n} runs (at least "
                f"{100 * best.met.low:.0f} % of all runs, with 95 % confidence)."
            )
        best = min(self.options, key=lambda o: (-o.met.mean, not o.steps.n, o.steps.mean))
        runs = f"{round(best.met.mean * best.met.n)} of {best.met.n} runs"
        result = ""
        if best.worst_map is not None:
            result = f", in {best.time}; its worst map is {100 * best.worst_map:.1f} % correct"
        return f"None of these teams always explores {building} {goal}; the best has {best}: {runs}{result}."

    @property
    def table(self) -> pl.DataFrame:
        """A row per option."""
        return pl.DataFrame(
            {
                "robots": o.robots, "bandwidth": str(o.bandwidth), "range": o.range, "runs": o.met.n,
                "met": o.met.mean, "met_low": o.met.low, "met_high": o.met.high,
                "steps": o.steps.mean, "steps_low": o.steps.low, "steps_high": o.steps.high,
            }
            for o in self.options
        )  # fmt: skip

    def plot(self, style: FigureStyle = DEFAULT) -> Figure:
        """Steps over the number of robots, with a curve per bandwidth, a panel per range, and 95 % intervals."""
        canvas = self.sweep.plot(0, style)
        deadline = self.requirements.deadline
        if deadline is not None:
            for panel in canvas.axes:
                panel.axhline(deadline, color="#555555", linewidth=1, linestyle="--")
                panel.set_ylim(top=max(1.05 * deadline, panel.get_ylim()[1]))
            panel.text(1.01, deadline, "deadline", transform=panel.get_yaxis_transform(), va="center")
        return canvas

    def write(self, folder: Path, style: FigureStyle = DEFAULT) -> list[Path]:
        """Write ``size.png`` and ``size.csv``, and all formats of a style."""
        return write_result(folder, "size", self.plot(style), self.table, style)

    def __repr__(self) -> str:
        return f"<Sizing of {len(self.sweep.rows)} runs: {self.sentence}>"

    def _repr_html_(self) -> str:
        return f"<p>{self.sentence}</p>{plots.as_html(self.plot())}{self.table._repr_html_()}"


def size(
    map: str,
    *,
    robots: Sequence[int] = range(2, 9),
    bandwidth: Sequence[int | str] = (100, 1000, 10000),
    range: Sequence[str] = ("30%", "100%"),
    deadline: int | None = None,
    min_map_accuracy: float = MIN_MAP_ACCURACY,
    finish: str = "all",
    seeds: int = SEEDS,
    jobs: int | None = None,
    scheduler: str | None = None,
    out: Path | str | None = None,
    progress: bool = True,
    **settings: Any,
) -> Sizing:
    """Test teams in a building; `Sizing.sentence` names the smallest sufficient one.

    Parameters
    ----------
    map : str
        A map file, or the name of a generator.
    robots, bandwidth, range : sequences
        The tested values; all combinations are run.
    deadline : int, optional
        Maximum number of steps of an exploration.
    min_map_accuracy : float
        Minimum share of correct cells on the final maps of the robots that must finish.
    finish : {"all", "first"}
        Which robots must finish: a run ends when all have, or with the first one.
    seeds : int
        Number of runs of each combination.
    **settings
        Other settings of all runs: ``map_encoding="predictive", dissemination="gossip"``.

    See Also
    --------
    deploy.study.sweep.sweep : the other parameters, and the errors
    """
    if isinstance(radio := settings.get("radio"), list | tuple):
        raise ScenarioError(f"radio = {radio!r}: sets bandwidth and range; size_radios tests several radios")
    grid: dict[str, list[Any]] = {
        "robots": sorted(listed("robots", robots)),
        "bandwidth": sorted(
            listed("bandwidth", bandwidth), key=lambda b: math.inf if isinstance(b, str) else b
        ),
        "range": listed("range", range),
        "seed": first_seeds(seeds),
    }
    requirements = Requirements(deadline, min_map_accuracy, finish)
    made = of_settings("size", {"map": map, "finish": finish, **settings}, grid, {"plain": {}}, METRICS)
    plot = Plot("steps", "robots", lines="bandwidth", panels="range")
    done = run(replace(made, plots=(plot,)), jobs=jobs, scheduler=scheduler, out=out, progress=progress)
    return Sizing(done, _options(done, requirements), requirements)


def _options(done: Sweep, requirements: Requirements) -> list[Option]:
    """The results of each tested team, ascending."""
    diagonal_m = load_map(done.cases[0].scenario).diagonal_m
    teams: dict[tuple[int, float, float], list[Case]] = {}
    for case in done.cases:
        scenario = case.scenario
        bandwidth = math.inf if scenario.bandwidth == WORD_FOR_UNLIMITED else float(scenario.bandwidth)
        size = scenario.robots, bandwidth, scenario.range_m(diagonal_m)
        teams.setdefault(size, []).append(case)
    options = []
    for _, cases in sorted(teams.items()):
        team = {key: cases[0].place[key] for key in KEYS}
        rows = [row for row in done.rows if team.items() <= row[PLACE].items()]
        met = sum(map(requirements.are_met, rows))
        finished = [row for row in rows if has_finished(row)]
        steps = interval([row["steps"] for row in finished])
        worst = min(map(requirements.accuracy, finished), default=None)
        options.append(Option(**team, met=share(met, len(cases)), steps=steps, worst_map=worst))
    return options
