"""The papers' claims and their verdicts: the implementation of `murmur reproduce`.

The shipped experiments name their claim in ``[claim]``. All their runs go into one table, so that a run of several
claims is made once. The rules of each claim (`deploy.study.claims`) yield its verdict, and two templates yield the
report. All its content comes from runs and from the experiments' files.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jinja2
import tomli_w

from deploy.record.versions import versions
from deploy.run.workers import Workers
from deploy.scenario.errors import ScenarioError
from deploy.study import experiment as experiments
from deploy.study.claims import HOLDS, Claim, Finding, Verdict, judge
from deploy.study.experiment import SHIPPED, Experiment
from deploy.study.figure_style import DEFAULT, FigureStyle
from deploy.study.paper_tables import write_tables
from deploy.study.progress import Report
from deploy.study.results import Results, write_table
from deploy.study.runs import cases, make
from deploy.study.sweep import Sweep
from deploy.study.tables import short
from protocol.errors import there_are
from worldsim.atomic_files import write_whole

CLAIMS = (
    *(f"M{n}" for n in range(1, 10)), *(f"B{n}" for n in range(1, 6)), *(f"L{n}" for n in range(1, 4)),
    *(f"F{n}" for n in range(1, 5)), *(f"A{n}" for n in range(1, 4)),
)  # fmt: skip
"""Claims of five papers: M of the thesis, B of Burgard, L of the leaders, F of Faigl, A of Al-khawaldah."""

TEMPLATES = Path(__file__).with_name("templates")
RUNS = "runs.parquet"


@dataclass(frozen=True, eq=False)
class Judged:
    """A claim, its verdict, and its experiments."""

    claim: Claim
    verdict: Verdict
    parts: list[Sweep]

    @property
    def runs(self) -> int:
        """Number of its runs."""
        return len({row["key"] for part in self.parts for row in part.rows})

    @property
    def explanation(self) -> str:
        """The explanations of its experiments."""
        claims = (part.experiment.claim for part in self.parts)
        return " ".join(claim.explanation for claim in claims if claim is not None and claim.explanation)


@dataclass(frozen=True, eq=False)
class Reproduction:
    """The requested claims in the papers' order."""

    claims: list[Judged]
    quick: bool
    without_experiment: list[str]

    @property
    def all_hold(self) -> bool:
        """Whether every claim holds."""
        return not self.without_experiment and all(judged.verdict.result == HOLDS for judged in self.claims)


def requested(names: Sequence[str], *, quick: bool, settings: dict[str, Any]) -> dict[str, list[Experiment]]:
    """The experiments of some claims (default: all) by claim, and those of files with a claim by file.

    ScenarioError for an unknown claim, or a file without one.
    """
    files = [name for name in names if name.endswith(".toml")]
    for name in names:
        if name.upper() not in CLAIMS and name not in files:
            raise ScenarioError(
                f"no claim is called {name!r}; {there_are(CLAIMS, name)}; or give a file with a claim"
            )
    wanted = [name for name in CLAIMS if name in {each.upper() for each in names} or not names]
    found: dict[str, list[Experiment]] = {name: [] for name in wanted}
    for name in files:
        own = experiments.read(Path(name))
        if own.claim is None:
            raise ScenarioError(f"experiment {name} has no table [claim]; murmur sweep {name} runs it")
        found[name] = [experiments.override(experiments.quickened(own) if quick else own, settings)]
    for path in sorted(SHIPPED.glob("*.toml")):
        experiment = experiments.read(path)
        claim = experiment.claim.id if experiment.claim is not None else None
        if claim in found:
            experiment = experiments.quickened(experiment) if quick else experiment
            found[claim].append(_with_existing_maps(experiments.override(experiment, settings)))
    return found


def _with_existing_maps(experiment: Experiment) -> Experiment:
    """The experiment without missing map files, because maps of real buildings are not shipped."""
    maps = experiment.grid.get("map", [])
    there = [each for each in maps if not (str(each).endswith(".yaml") and not Path(str(each)).exists())]
    return experiment if there == maps else replace(experiment, grid=experiment.grid | {"map": there})


def reproduce(
    found: dict[str, list[Experiment]],
    results: Results,
    workers: Workers,
    report: Report | None = None,
    *,
    quick: bool = False,
    retry: bool = False,
) -> Reproduction:
    """Make the runs that the table lacks, and judge each claim; `quick` says whether `found` was reduced."""
    todo = {name: [(each, cases(each)) for each in listed] for name, listed in found.items()}
    every = [case for listed in todo.values() for _, some in listed for case in some]
    make(every, results, workers, report, retry=retry)
    judged = []
    for listed in todo.values():
        parts = [Sweep(some, results, each) for each, some in listed]
        claims = [part.experiment.claim for part in parts if part.experiment.claim is not None]
        if claims:
            rules = ((claim.rule, part.rows) for claim, part in zip(claims, parts, strict=True))
            judged.append(Judged(claims[0], judge(rules), parts))
    return Reproduction(judged, quick, [name for name, listed in todo.items() if not listed])


def write(reproduction: Reproduction, out: Path, command: str, style: FigureStyle = DEFAULT) -> list[Path]:
    """Write ``OUT.md`` and ``OUT.html``, and pictures and tables into the folder ``OUT``; return the two pages."""
    out.mkdir(parents=True, exist_ok=True)
    write_tables(out / "claims", style, overview(reproduction))
    pictures: dict[str, list[str]] = {}
    for judged in reproduction.claims:
        write_tables(out / f"claim-{judged.claim.id}-tests", style, _tests(judged.verdict.findings))
        for part in judged.parts:
            name = part.experiment.name
            pictures[name] = []
            if not part.rows:
                continue
            for ending in (".csv", ".parquet"):
                write_table(part.table, out / f"{name}{ending}")
            part.write_tables(out / name, style)
            for number in range(len(part.experiment.plots)):
                file = out / f"{name}-{number + 1}.png"
                style.save(part.plot(number, style), file)
                pictures[name].append(f"{out.name}/{file.name}")
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=lambda name: "html" in (name or ""),
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters |= {"effect": _effect, "p": _p, "cell": _cell, "settings": _settings}
    pages = []
    for name in ("reproduction.md.jinja", "reproduction.html.jinja"):
        page = out.with_name(f"{out.name}.{name.split('.')[1]}")
        text = environment.get_template(name).render(
            reproduction=reproduction, pictures=pictures, command=command, versions=versions(), folder=out.name,
        )  # fmt: skip
        write_whole(page, lambda file, text=text: file.write(text.encode()))  # type: ignore[misc]
        pages.append(page)
    return pages


def overview(reproduction: Reproduction) -> list[list[str]]:
    """The claims with their verdicts, as a table."""
    lines = [["claim", "", "verdict", "tests", "runs"]]
    for each in reproduction.claims:
        verdict = each.verdict
        lines.append([each.claim.id, each.claim.statement, verdict.result, verdict.counts, str(each.runs)])
    return lines + [[name, "", "no experiment", "", "0"] for name in reproduction.without_experiment]


def _tests(findings: Sequence[Finding]) -> list[list[str]]:
    """The tests of a claim, as a table."""
    lines = [[
        "expected", "metric", "expectation", "where", "result", "effect size", "n", "excluded", "p", "verdict",
    ]]  # fmt: skip
    for each in findings:
        size = "-" if each.d != each.d else f"{each.d:.2f}"
        counts = str(each.effect.n), str(each.left_out)
        lines.append(
            [each.rule.statement, each.rule.metric, each.rule.expect, _cell(each.cell), _effect(each), size, *counts,
             _p(each.p), each.verdict]
        )  # fmt: skip
    return lines


def _settings(experiment: Experiment) -> str:
    """The settings of an experiment as TOML, with map files without their folders."""
    grid = experiment.grid
    if "map" in grid:
        grid = grid | {"map": [Path(each).name if isinstance(each, str) else each for each in grid["map"]]}
    tables: dict[str, Any] = {"base": experiment.base, "grid": grid, "follow": experiment.follow}
    variants = [{"name": name, **keys} for name, keys in experiment.variants.items()]
    if len(variants) > 1 or len(variants[0]) > 1:
        tables |= {"variant": variants}
    return tomli_w.dumps({name: table for name, table in tables.items() if table})


def _effect(finding: Finding) -> str:
    """The effect with its interval, as text."""
    effect = finding.effect
    if not effect.n:
        return "no runs"
    bounds = "" if effect.low != effect.low else f" [{effect.low:.3g}, {effect.high:.3g}]"
    return f"{effect.mean:.3g}{bounds}"


def _p(value: float) -> str:
    return "< 0.001" if value < 0.001 else f"{value:.3f}"


def _cell(cell: dict[str, Any]) -> str:
    """The cell of a test, as text."""
    return ", ".join(f"{key} {short(value)}" for key, value in cell.items()) or "all runs"
