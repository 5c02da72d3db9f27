"""Many runs from Python: ``sweep("lossy.toml", quick=True)``, ``sweep(robots=[2, 4], seed=[0, 1], map="office")``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl
from rich.console import Console

from deploy.run.failure import RunFailed
from deploy.run.workers import workers
from deploy.scenario import plugins
from deploy.scenario.errors import ScenarioError
from deploy.study import experiment as experiments
from deploy.study import paper_tables, plots
from deploy.study.experiment import Experiment
from deploy.study.figure_style import DEFAULT, FigureStyle
from deploy.study.measures import EXPLORATION, METRICS
from deploy.study.progress import counting
from deploy.study.results import PLACE, open_results
from deploy.study.runs import StudyRuns, cases, make
from deploy.study.tables import DEFAULT_METRICS, VARIANT, Table, check, described, means, names_of, tabulate

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class Sweep(StudyRuns):
    """The runs of an experiment; a notebook shows the table of means."""

    experiment: Experiment
    """The experiment that was run; it also defines the table and the plots."""

    def make(
        self, *, jobs: int | None, scheduler: str | None, progress: bool = True, retry: bool = False
    ) -> None:
        """Execute all runs that the table lacks; parameters as for `sweep`. `retry` repeats failed runs."""
        pool = workers(jobs, scheduler)
        with counting(Console(stderr=True, quiet=not progress), self.experiment.name) as report:
            make(self.cases, self.results, pool, report, retry=retry)

    @property
    def runs(self) -> pl.DataFrame:
        """A row per run: keys of the grid and the variant first, then all settings and metrics."""
        names = {key: names_of(self.rows, key) for key in (self.rows[0][PLACE] if self.rows else ())}
        return pl.DataFrame(
            [
                {name: names[name][repr(value)] if isinstance(value, str | dict | list) else value
                 for name, value in row[PLACE].items()}
                | {name: value for name, value in row.items() if name != PLACE and name not in row[PLACE]}
                for row in self.rows
            ],
            infer_schema_length=None,
        )  # fmt: skip

    @property
    def table(self) -> pl.DataFrame:
        """Means, 95 % intervals and quartiles of each cell of the experiment's table."""
        return described(self.experiment.table, self.rows)

    def plot(self, number: int = 0, style: FigureStyle = DEFAULT) -> Figure:
        """Draw one of the experiment's plots; ValueError if there is none."""
        if number >= len(self.experiment.plots) or not self.rows:
            raise ValueError(f"there is no plot {number}: the experiment has {len(self.experiment.plots)}")
        return plots.draw(self.experiment.plots[number], self.rows, self.results, style)

    def write_tables(self, stem: Path, style: FigureStyle) -> None:
        """Write the experiment's table for papers (`deploy.study.paper_tables.write_tables`)."""
        table, rows = self.experiment.table, self.rows
        paper_tables.write_tables(stem, style, tabulate(table, rows), means(table, rows))

    def __repr__(self) -> str:
        failed = f", {sum(self.failures.values())} failed" if self.failures else ""
        return f"<Sweep {self.experiment.name}: {len(self.rows)} of {len(self.cases)} runs{failed}>"

    def _repr_html_(self) -> str:
        return f"<p>{self.experiment.name}: {len(self.rows)} runs</p>{self.table._repr_html_()}"


def sweep(
    experiment: Path | str | Experiment | None = None,
    *,
    base: dict[str, Any] | None = None,
    variants: dict[str, dict[str, Any]] | None = None,
    metrics: Sequence[str] = DEFAULT_METRICS,
    quick: bool = False,
    jobs: int | None = None,
    scheduler: str | None = None,
    out: Path | str | None = None,
    retry: bool = False,
    progress: bool = True,
    **settings: Any,
) -> Sweep:
    """Run an experiment, or all combinations of settings, and return the runs.

    Parameters
    ----------
    experiment : path, name or Experiment, optional
        A file as for `murmur sweep`; `settings` replace values of its grid and base.
    base : dict, optional
        Without an experiment: settings of all runs.
    variants : dict of name to settings, optional
        Without an experiment: variants, each run on the whole grid.
    metrics : sequence of str
        Without an experiment: the columns of `Sweep.table`.
    quick : bool
        Whether to run the reduced experiment of ``[quick]``.
    jobs : int, optional
        Number of processes; by default one per core.
    scheduler : str, optional
        Address of a Dask scheduler; its workers make the runs instead.
    out : Path or str, optional
        File of the table of runs (parquet); runs in it are not repeated.
    retry : bool
        Whether to repeat failed runs of the table.
    progress : bool
        Whether to show progress and the remaining time.
    **settings
        Single values, and lists of which all combinations are run: ``robots=[2, 4], map="office"``.

    Raises
    ------
    ValueError
        A setting, the experiment or `out` is invalid; nothing has been run.
    RunFailed
        All runs failed. `Sweep.failures` has the causes if only some did.
    """
    if experiment is None:
        metrics = experiments.listed("metrics", metrics)
        for metric in metrics:
            check(metric, variants or {}, METRICS[EXPLORATION])
        read = of_settings("sweep", base or {}, settings, variants or {"plain": {}}, metrics)
    else:
        if base or variants:
            raise ScenarioError("base and variants: only without an experiment, which has its own")
        read = experiment if isinstance(experiment, Experiment) else experiments.read(Path(experiment))
        read = experiments.quickened(read) if quick else read
        read = experiments.override(read, plugins.plain_settings(settings))
    return run(read, jobs=jobs, scheduler=scheduler, out=out, retry=retry, progress=progress)


def run(
    experiment: Experiment,
    *,
    jobs: int | None,
    scheduler: str | None,
    out: Path | str | None,
    retry: bool = False,
    progress: bool,
) -> Sweep:
    """Run an experiment; parameters and errors as for `sweep`."""
    todo = cases(experiment)
    with open_results(out) as results:
        done = Sweep(todo, results, experiment)
        done.make(jobs=jobs, scheduler=scheduler, progress=progress, retry=retry)
    if not done.rows and done.failures:
        raise RunFailed(f"all runs failed: {as_text(done.failures)}")
    return done


def as_text(failures: dict[str, int]) -> str:
    """Return causes of failed runs with their counts, as text."""
    return "; ".join(f"{cause} ({count} run{'s' if count > 1 else ''})" for cause, count in failures.items())


def of_settings(
    name: str,
    base: dict[str, Any],
    settings: dict[str, Any],
    variants: dict[str, dict[str, Any]],
    metrics: Sequence[str],
) -> Experiment:
    """Make an experiment of settings; the lists become its grid."""
    base, settings = plugins.plain_settings(base), plugins.plain_settings(settings)
    variants = {key: plugins.plain_settings(keys) for key, keys in variants.items()}
    grid = {
        key: experiments.listed(key, values)
        for key, values in settings.items()
        if isinstance(values, list | tuple | range)
    }
    single = {key: value for key, value in settings.items() if key not in grid}
    rows = [key for key in grid if key != "seed"] + ([VARIANT] if len(variants) > 1 else [])
    table = Table(rows, [], list(metrics), interval=True, finished_only=True)
    made = Experiment(name, name, base | single, {key: [] for key in grid}, {}, variants, table)
    return experiments.override(made, grid)
