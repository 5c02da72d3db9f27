"""Find the smallest team for each of some radios in a building: `murmur size --radio`.

Teams grow until all runs of a radio meet the requirements. So a radio that suffices for few robots costs few runs.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl
from rich.console import Console

from deploy.run.failure import RunFailed
from deploy.run.workers import Workers, workers
from deploy.scenario.radio_presets import preset_of
from deploy.study import plots
from deploy.study.experiment import first_seeds, listed
from deploy.study.figure_style import DEFAULT, FigureStyle
from deploy.study.paper_tables import write_result
from deploy.study.plots import Plot
from deploy.study.progress import Report, counting
from deploy.study.results import PLACE, Results, open_results
from deploy.study.runs import Case, StudyRuns, cases, make
from deploy.study.sizing import METRICS, MIN_MAP_ACCURACY, SEEDS, Requirements
from deploy.study.statistics import Interval, interval, share
from deploy.study.sweep import as_text, of_settings
from deploy.study.tables import has_finished, short
from protocol.presets import UNKNOWN, Limit, preset

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class RadioAnswer:
    """The smallest team that suffices with a radio, or else the best of those tried."""

    radio: str
    """Name of the preset."""
    tried: list[int]
    """The tried numbers of robots, ascending."""
    robots: int
    """The number of robots that the other attributes describe."""
    met: int
    """How many of its runs met the requirements."""
    runs: int
    steps: Interval
    """Steps of its finished runs; a step is a second."""
    worst_map: float | None
    """Share of the building that the worst robot of all its runs has right; None if all runs failed."""
    duty_cycle: float | None
    """Largest share of an hour in which a robot sent; None if all runs failed."""

    @property
    def is_enough(self) -> bool:
        """Whether all runs met the requirements."""
        return self.met == self.runs

    @property
    def limit(self) -> Limit:
        """The legal limit."""
        return preset(self.radio).limit

    @property
    def texts(self) -> list[str]:
        """The cells of its row in the printed table."""
        tried = f"{self.tried[0]} to {self.tried[-1]}" if len(self.tried) > 1 else f"{self.tried[0]}"
        team = f"{self.robots}" if self.is_enough else f"none of {tried}; best {self.robots}"
        time = f"{self.steps.mean:.0f}" if self.steps.n else "-"
        legal = f"{100 * self.limit.duty_cycle:g} %" if self.limit.duty_cycle < 1 else "none"
        legal = UNKNOWN.source if self.limit == UNKNOWN else f"{legal}, {self.limit.source}"
        return [
            self.radio, team, f"{self.met} of {self.runs}",
            time + (f" ± {self.steps.half:.0f}" if self.steps.n > 1 else ""),
            *("-" if share is None else f"{100 * share:.3g} %" for share in (self.worst_map, self.duty_cycle)),
            legal,
        ]  # fmt: skip


HEAD = [
    "radio", "robots", "sufficient runs", "time, s", "worst robot's map", "duty cycle used", "legal limit",
]  # fmt: skip
"""The columns of the printed table."""


@dataclass(frozen=True, eq=False, repr=False)
class RadioSizing(StudyRuns):
    """The smallest team for each radio; a notebook shows the sentences, curves and table."""

    answers: list[RadioAnswer]
    """One per radio, in the given order."""
    goal: str
    """The requirements as text."""

    @property
    def lines(self) -> list[list[str]]:
        """The printed table: a header, and a line per radio."""
        return [HEAD, *(answer.texts for answer in self.answers)]

    @property
    def sentences(self) -> list[str]:
        """What the table shows, and the duty cycles that were applied."""
        applied = {case.place["radio"]: case.scenario.radio.duty_cycle for case in self.cases}
        limited = [answer for answer in self.answers if answer.limit.duty_cycle < 1]
        obeying = [a.radio for a in limited if applied[a.radio] <= a.limit.duty_cycle]
        others = [a.radio for a in limited if a.radio not in obeying]
        sentences = [f"The smallest team of which all runs explore {self.goal}."]
        if runs := min((a.runs for a in self.answers if a.is_enough), default=0):
            low = 100 * share(runs, runs).low
            sentences.append(
                f"{runs} of {runs} runs mean at least {low:.0f} % of all runs, with 95 % confidence."
            )
        if obeying:
            sentences.append(
                f"Duty cycles keep the legal limit ({', '.join(obeying)}); --set radio.duty_cycle=1 switches them off."
            )
        if others:
            sentences.append(f"Duty cycles do not keep the legal limit ({', '.join(others)}).")
        return sentences

    @property
    def table(self) -> pl.DataFrame:
        """A row per radio."""
        return pl.DataFrame(
            {
                "radio": a.radio, "is_enough": a.is_enough, "robots": a.robots, "runs": a.runs, "met": a.met,
                "steps": a.steps.mean, "steps_low": a.steps.low, "steps_high": a.steps.high,
                "worst_map": a.worst_map, "duty_cycle": a.duty_cycle, "duty_cycle_limit": a.limit.duty_cycle,
                "limit_source": a.limit.source,
            }
            for a in self.answers
        )  # fmt: skip

    def plot(self, style: FigureStyle = DEFAULT) -> Figure:
        """Steps over the number of robots, with a curve per radio and 95 % intervals."""
        plot = Plot("steps", "robots", lines="radio", ylabel="exploration time (steps)", finished_only=False)
        return plots.draw(plot, self.rows, self.results, style)

    def write(self, folder: Path, style: FigureStyle = DEFAULT) -> list[Path]:
        """Write ``radios.png`` and ``radios.csv``, and all formats of a style."""
        return write_result(folder, "radios", self.plot(style), self.table, style)

    def __repr__(self) -> str:
        teams = ", ".join(f"{a.radio}: {a.robots if a.is_enough else 'none'}" for a in self.answers)
        return f"<RadioSizing of {len(self.rows)} runs: {teams}>"

    def _repr_html_(self) -> str:
        sentences = " ".join(self.sentences)
        return f"<p>{sentences}</p>{plots.as_html(self.plot())}{self.table._repr_html_()}"


def size_radios(
    map: str,
    radio: Sequence[str],
    *,
    robots: Sequence[int] = range(2, 9),
    deadline: int | None = None,
    min_map_accuracy: float = MIN_MAP_ACCURACY,
    finish: str = "all",
    seeds: int = SEEDS,
    jobs: int | None = None,
    scheduler: str | None = None,
    out: Path | str | None = None,
    progress: bool | Report = True,
    **settings: Any,
) -> RadioSizing:
    """Find the smallest team for each radio in a building.

    Parameters
    ----------
    map : str
        A map file, or the name of a generator.
    radio : sequence of str
        Names of radio presets.
    robots : sequence of int
        The numbers of robots to try, from the smallest until one suffices.
    progress : bool or Report
        Whether to show progress, or what to call with the numbers of finished runs and of all runs; the latter grows
        if a radio needs a larger team.

    See Also
    --------
    deploy.study.sizing.size : the other parameters, and the errors
    """
    for name in (radio := listed("radio", radio)):
        preset_of(name)
    grid = {"radio": radio, "robots": sorted(listed("robots", robots)), "seed": first_seeds(seeds)}
    requirements = Requirements(deadline, min_map_accuracy, finish)
    made = of_settings("size", {"map": map, "finish": finish, **settings}, grid, {"plain": {}}, METRICS)
    possible = cases(made)
    console = Console(stderr=True, quiet=not progress)
    with (
        open_results(out) as results,
        nullcontext(progress) if callable(progress) else counting(console, "size") as report,
    ):
        runs = StudyRuns(_search(possible, results, requirements, report, workers(jobs, scheduler)), results)
    if not runs.rows:
        raise RunFailed(f"all runs failed: {as_text(runs.failures)}")
    answers = [_answer(name, runs, requirements) for name in radio]
    return RadioSizing(runs.cases, results, answers, f"{short(map)} {requirements}")


def _search(
    possible: Sequence[Case], results: Results, requirements: Requirements, report: Report, pool: Workers
) -> list[Case]:
    """Run the cases by growing teams, and each radio until a team suffices; return those that were run."""
    run: list[Case] = []
    enough: set[str] = set()
    for robots in dict.fromkeys(case.place["robots"] for case in possible):
        todo = [c for c in possible if c.place["robots"] == robots and c.place["radio"] not in enough]
        make(todo, results, pool, _after(len(run), report))
        run += todo
        rows = StudyRuns(todo, results).rows
        met = Counter(row[PLACE]["radio"] for row in rows if requirements.are_met(row))
        enough |= {
            name for name, count in Counter(c.place["radio"] for c in todo).items() if met[name] == count
        }
    return run


def _after(before: int, report: Report) -> Report:
    """Report the progress of runs after `before` others."""
    return lambda done, total: report(before + done, before + total)


def _answer(radio: str, runs: StudyRuns, requirements: Requirements) -> RadioAnswer:
    """The smallest sufficient team of a radio, or else the one with most sufficient runs, then the fastest."""
    places = [case.place for case in runs.cases if case.place["radio"] == radio]
    tried = Counter(place["robots"] for place in places)
    teams = []
    for robots, number in tried.items():
        own = [row for row in runs.rows if (row[PLACE]["radio"], row[PLACE]["robots"]) == (radio, robots)]
        steps = interval([row["steps"] for row in own if has_finished(row)])
        met = sum(map(requirements.are_met, own))
        worst = min((row["worst_map_accuracy"] or 0.0 for row in own), default=None)
        used = max((row["duty_cycle"] or 0.0 for row in own), default=None)
        teams.append(RadioAnswer(radio, sorted(tried), robots, met, number, steps, worst, used))
    return min(teams, key=lambda team: (-team.met, not team.steps.n, team.steps.mean))
