"""The papers' claims, each with a verdict: what `murmur reproduce` runs and reports.

A claim's experiments are the shipped ones whose ``[claim]`` has its name. All their runs go into one table, so that
what two claims ask for is run once; then each claim is judged by its rules (`deploy.study.claims`), and the report is
written from two templates. Nothing in it is written by hand but what stands in the experiments' files.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import jinja2
import polars as pl
import tomli_w

from deploy.record.versions import versions
from deploy.run.workers import Workers
from deploy.scenario.scenario import ScenarioError
from deploy.study import experiment as experiments
from deploy.study import plots
from deploy.study.claims import HOLDS, Claim, Finding, Rule, Verdict, judge
from deploy.study.experiment import SHIPPED, Experiment
from deploy.study.progress import Tell
from deploy.study.results import Results, Row, write_table
from deploy.study.runs import Case, cases, failures, looked_up, make
from deploy.study.tables import described
from protocol.errors import there_are
from worldsim.atomic_files import write_whole

CLAIMS = (
    *(f"M{n}" for n in range(1, 10)), *(f"B{n}" for n in range(1, 6)), *(f"L{n}" for n in range(1, 4)),
    *(f"F{n}" for n in range(1, 5)), *(f"A{n}" for n in range(1, 4)),
)  # fmt: skip
"""Of the five papers: M of the thesis, B Burgard's, L of the leaders, F Faigl's, A Al-khawaldah's."""

TEMPLATES = Path(__file__).with_name("templates")
RUNS = "runs.parquet"


@dataclass(frozen=True, eq=False)
class Part:
    """An experiment of a claim, its cases and its runs."""

    experiment: Experiment
    cases: list[Case]
    rows: list[Row]
    failures: dict[str, int]

    @property
    def name(self) -> str:
        """The experiment's name."""
        return self.experiment.name

    @cached_property
    def settings(self) -> str:
        """What was run, as TOML; maps by their files' names, wherever they were found."""
        grid = self.experiment.grid
        if "map" in grid:
            grid = grid | {
                "map": [Path(each).name if isinstance(each, str) else each for each in grid["map"]]
            }
        told = {"base": self.experiment.base, "grid": grid, "follow": self.experiment.follow}
        variants = [{"name": name, **keys} for name, keys in self.experiment.variants.items()]
        if len(variants) > 1 or len(variants[0]) > 1:
            told["variant"] = variants  # type: ignore[assignment]
        return tomli_w.dumps({name: table for name, table in told.items() if table})

    @cached_property
    def table(self) -> pl.DataFrame:
        """Means, intervals and five numbers of each cell of the experiment's table."""
        return described(self.experiment.table, self.rows)


@dataclass(frozen=True, eq=False)
class Judged:
    """A claim, its verdict, and the parts that it follows from."""

    claim: Claim
    verdict: Verdict
    parts: list[Part]

    @property
    def runs(self) -> int:
        """Runs that it rests on."""
        return len({row["key"] for part in self.parts for row in part.rows})

    @property
    def explanation(self) -> str:
        """The remarks of its experiments."""
        return " ".join(part.experiment.claim.explanation for part in self.parts if part.experiment.claim)


@dataclass(frozen=True, eq=False)
class Reproduction:
    """All claims that were asked for, in the papers' order, and how they were run."""

    claims: list[Judged]
    quick: bool
    results: Results
    unasked: list[str]
    """Claims of which no experiment is there."""

    @property
    def all_hold(self) -> bool:
        """Whether every claim holds."""
        return not self.unasked and all(judged.verdict.word == HOLDS for judged in self.claims)


def asked(names: Sequence[str], *, quick: bool, settings: dict[str, Any]) -> dict[str, list[Experiment]]:
    """The experiments of some claims (none named: all), by claim; ScenarioError if there is no such claim."""
    for name in names:
        if name.upper() not in CLAIMS:
            raise ScenarioError(f"no claim is called {name!r}; {there_are(CLAIMS, name)}")
    wanted = [name for name in CLAIMS if name in {word.upper() for word in names} or not names]
    found: dict[str, list[Experiment]] = {name: [] for name in wanted}
    for path in sorted(SHIPPED.glob("*.toml")):
        experiment = experiments.read(path)
        claim = experiment.claim.id if experiment.claim is not None else None
        if claim in found:
            experiment = experiments.quickened(experiment) if quick else experiment
            found[claim].append(_on_maps_at_hand(experiments.override(experiment, settings)))
    return found


def _on_maps_at_hand(experiment: Experiment) -> Experiment:
    """The experiment without map files that are not there: real buildings are not shipped. No run decides nothing."""
    maps = experiment.grid.get("map", [])
    there = [each for each in maps if not (str(each).endswith(".yaml") and not Path(str(each)).exists())]
    return experiment if there == maps else replace(experiment, grid=experiment.grid | {"map": there})


def reproduce(
    found: dict[str, list[Experiment]],
    results: Results,
    workers: Workers,
    tell: Tell | None = None,
    *,
    quick: bool = False,
    any_code: bool = False,
    retry: bool = False,
) -> Reproduction:
    """Run what the table has not, and judge each claim.

    Parameters
    ----------
    found : dict of claim to experiments
        From `asked`.
    quick : bool
        Whether these are first looks: the report says so.
    """
    todo = {name: [(each, cases(each)) for each in listed] for name, listed in found.items()}
    every = [case for listed in todo.values() for _, some in listed for case in some]
    make(every, results, workers, tell, any_code=any_code, retry=retry)
    judged, unasked = [], []
    for name, listed in todo.items():
        parts = [Part(each, some, looked_up(some, results), failures(some, results)) for each, some in listed]
        if not parts:
            unasked.append(name)
            continue
        claim = parts[0].experiment.claim
        assert claim is not None
        judged.append(Judged(claim, judge(_rules(parts)), parts))
    return Reproduction(judged, quick, results, unasked)


def write(reproduction: Reproduction, out: Path, command: str) -> list[Path]:
    """Write ``OUT.md`` and ``OUT.html``, and pictures and tables into the folder ``OUT``; return the two pages."""
    out.mkdir(parents=True, exist_ok=True)
    pictures: dict[str, list[str]] = {}
    for judged in reproduction.claims:
        for part in judged.parts:
            for ending in (".csv", ".parquet") if part.rows else ():
                write_table(part.table, out / f"{part.name}{ending}")
            pictures[part.name] = []
            for number, plot in enumerate(part.experiment.plots if part.rows else (), 1):
                file = out / f"{part.name}-{number}.png"
                plots.save(plots.draw(plot, part.rows, reproduction.results), file)
                pictures[part.name].append(f"{out.name}/{file.name}")
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=lambda name: "html" in (name or ""),
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters |= {"effect": _effect, "p": _p, "cell": _cell}
    pages = []
    for name in ("reproduction.md.jinja", "reproduction.html.jinja"):
        page = out.with_name(f"{out.name}.{name.split('.')[1]}")
        text = environment.get_template(name).render(
            reproduction=reproduction, pictures=pictures, command=command, versions=versions(), folder=out.name,
        )  # fmt: skip
        write_whole(page, lambda file, text=text: file.write(text.encode()))  # type: ignore[misc]
        pages.append(page)
    return pages


def _rules(parts: Sequence[Part]) -> Iterator[tuple[Sequence[Rule], list[Row]]]:
    for part in parts:
        if part.experiment.claim is not None:
            yield part.experiment.claim.rules, part.rows


def _effect(finding: Finding) -> str:
    """What was found, with its interval."""
    effect = finding.effect
    if not effect.n:
        return "no runs"
    bounds = "" if effect.low != effect.low else f" [{effect.low:.3g}, {effect.high:.3g}]"
    return f"{effect.mean:.3g}{bounds}"


def _p(value: float) -> str:
    return "< 0.001" if value < 0.001 else f"{value:.3f}"


def _cell(cell: dict[str, Any]) -> str:
    """The cell of a test, in words."""
    return ", ".join(f"{key} {plots.short(value)}" for key, value in cell.items()) or "all runs"
