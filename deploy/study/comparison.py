"""Compare settings: paired runs, a verdict for each pair of settings, box plots and curves."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl

from deploy.run.failure import RunFailed
from deploy.scenario import plugins
from deploy.scenario.errors import ScenarioError
from deploy.scenario.scenario import Scenario, load
from deploy.scenario.toml_files import remove_preset_keys
from deploy.study import plots
from deploy.study.claims import HOLDS, UNDECIDED, Finding, Rule, judge
from deploy.study.experiment import first_seeds
from deploy.study.figure_style import DEFAULT, FigureStyle
from deploy.study.measures import EXPLORATION
from deploy.study.measures import METRICS as MEASURED
from deploy.study.plots import BOXES, CURVES, Plot
from deploy.study.results import write_table
from deploy.study.runs import StudyRuns
from deploy.study.sweep import Sweep, as_text, of_settings, run
from deploy.study.tables import VARIANT, check

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SEEDS = 10

METRICS = (
    "steps", "t90", "map_accuracy", "mean_map_accuracy", "worst_map_accuracy", "claimed_worst_wall_f1",
    "walls_within_tolerance", "bytes.total",
)  # fmt: skip
"""The metrics of the table, besides the compared one."""

RECORDED_METRICS = ("steps_after_scans", "bytes_per_scan")
"""Metrics that are added if all scenarios replay logs."""

REPLACED = ("seed", "bus")
"""Settings of a scenario that the comparison replaces."""


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """The comparison of settings; a notebook shows its verdicts, table and pictures."""

    sweep: Sweep
    metric: str
    findings: list[Finding]
    """A paired test for each pair of settings, corrected for their number (Holm)."""

    @property
    def verdicts(self) -> list[str]:
        """A sentence for each pair of settings."""
        return [_sentence(self.metric, finding) for finding in self.findings]

    @property
    def table(self) -> pl.DataFrame:
        """Means, intervals and quartiles."""
        return self.sweep.table

    def plot(self, style: FigureStyle = DEFAULT) -> Figure:
        """Box plots of the metric."""
        return self.sweep.plot(0, style)

    def curves(self, style: FigureStyle = DEFAULT) -> Figure:
        """The explored share over time, means with 95 % intervals."""
        return self.sweep.plot(1, style)

    def write(self, folder: Path, style: FigureStyle = DEFAULT) -> list[Path]:
        """Write ``boxes.png``, ``curves.png`` and ``means.csv``, and all formats of a style."""
        files = [folder / name for name in ("boxes.png", "curves.png", "means.csv")]
        style.save(self.plot(style), files[0])
        style.save(self.curves(style), files[1])
        write_table(self.table, files[2])
        self.sweep.write_tables(folder / "means", style)
        return files

    def __repr__(self) -> str:
        return f"<Comparison of {len(self.sweep.rows)} runs: {'; '.join(self.verdicts)}>"

    def _repr_html_(self) -> str:
        pictures = "".join(plots.as_html(canvas) for canvas in (self.plot(), self.curves()))
        sentences = "".join(f"<li>{sentence}</li>" for sentence in self.verdicts)
        return f"<ul>{sentences}</ul>{pictures}{self.table._repr_html_()}"


def compare(
    scenarios: Sequence[Scenario | dict[str, Any] | Path | str] | dict[str, dict[str, Any]],
    *,
    seeds: int = SEEDS,
    metric: str = "steps",
    jobs: int | None = None,
    scheduler: str | None = None,
    out: Path | str | None = None,
    progress: bool = True,
    **settings: Any,
) -> Comparison:
    """Run scenarios on the same seeds and test which is better.

    Parameters
    ----------
    scenarios : sequence of Scenario, settings or paths; or dict of name to settings
        Two or more scenarios. Their seeds are replaced.
    seeds : int
        Number of runs of each scenario on each map, at least 2.
    metric : str
        The compared metric, a key of ``summary.json`` (docs/reference/files.md).
    **settings
        Settings of all scenarios; lists are factors: ``map=["office", "mixed"], robots=4``.

    Raises
    ------
    ValueError
        There are fewer than two scenarios, or one is invalid; nothing has been run.
    RunFailed
        All runs of a scenario failed, so that there is nothing to compare it with.

    See Also
    --------
    deploy.study.sweep.sweep : the other parameters
    """
    variants, settings = _named(scenarios), plugins.plain_settings(settings)
    if len(variants) < 2:
        raise ScenarioError("there is nothing to compare: give at least two scenarios")
    check(metric, (), MEASURED[EXPLORATION])
    for keys in variants.values() if "radio" in settings else ():
        remove_preset_keys(keys, {"radio": ""})
    taken = [key for key in settings if any(key in keys for keys in variants.values())]
    variants = {name: {k: v for k, v in keys.items() if k not in taken} for name, keys in variants.items()}
    if len({repr(keys) for keys in variants.values()}) < len(variants):
        raise ScenarioError("two of the scenarios are the same")
    recorded = RECORDED_METRICS if all("recording" in keys for keys in variants.values()) else ()
    metrics = list(dict.fromkeys((metric, *recorded, *METRICS)))
    made = of_settings("compare", {}, {**settings, "seed": first_seeds(seeds, least=2)}, variants, metrics)
    panels = "map" if "map" in made.grid else ""
    boxes = Plot(metric, kind=BOXES, panels=panels)
    curves = Plot("explored", kind=CURVES, panels=panels)
    made = replace(made, plots=(boxes, curves))
    done = run(made, jobs=jobs, scheduler=scheduler, out=out, progress=progress)
    _check_runs(done, variants)
    rules = [
        Rule("", metric, "ratio < 1", compare={VARIANT: one}, to={VARIANT: other})
        for one, other in combinations(variants, 2)
    ]
    return Comparison(done, metric, judge([(rules, done.rows)]).findings)


def varied(scenario: Path, key: str, values: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return the settings of a scenario with each value of a setting, by the values.

    Raises ScenarioError if the scenario cannot be read, or a value does not fit it.
    """
    return {value: _settings(load(scenario, {key: value})) for value in values}


def _check_runs(done: Sweep, variants: Iterable[str]) -> None:
    """Raise RunFailed if all runs of a variant failed."""
    for name in variants:
        runs = StudyRuns([case for case in done.cases if case.place[VARIANT] == name], done.results)
        if not runs.rows and runs.failures:
            raise RunFailed(f"{name}: all runs failed: {as_text(runs.failures)}")


def _named(
    scenarios: Sequence[Scenario | dict[str, Any] | Path | str] | dict[str, dict[str, Any]],
) -> dict[str, dict[str, Any]]:
    """The settings of each scenario by a name: that of its file, or its differing settings."""
    if isinstance(scenarios, str | Path | Scenario):
        raise ScenarioError(f"scenarios = {str(scenarios)!r}: must be a list, or a dict")
    if isinstance(scenarios, dict):
        return {name: plugins.plain_settings(keys) for name, keys in scenarios.items()}
    named: dict[str, dict[str, Any]] = {}
    settings = [_settings(each) for each in scenarios]
    for each, own in zip(scenarios, settings, strict=True):
        if isinstance(each, str | Path):
            name = Path(each).stem
        elif own in named.values():
            same = ", ".join(f"{key} = {value}" for key, value in own.items())
            raise ScenarioError(f"two of the scenarios are the same: {same}")
        else:
            differing = {k: v for k, v in own.items() if any(other.get(k) != v for other in settings)}
            keyed = {k: f"{k} {v}" for k, v in differing.items()}
            words = {
                k: plugins.own_name(k, v)
                for k, v in differing.items()
                if isinstance(v, str) and v[:1].isalpha()
            }
            name = ", ".join((keyed | words).values()) or "plain"
            if name in named:
                name = ", ".join(keyed.values())
        if name in named:
            raise ScenarioError(f"two scenarios are called {name!r}: rename a file, or use a dict in Python")
        named[name] = own
    return named


def _settings(scenario: Scenario | dict[str, Any] | Path | str) -> dict[str, Any]:
    """The explicit settings of a scenario, without those that the comparison replaces."""
    if isinstance(scenario, str | Path):
        _check_not_named(str(scenario))
        scenario = load(Path(scenario), {})
    if isinstance(scenario, Scenario):
        scenario = scenario.model_dump(mode="json", exclude_unset=True)
    return plugins.plain_settings({key: value for key, value in scenario.items() if key not in REPLACED})


def _check_not_named(file: str) -> None:
    """Raise ScenarioError if the name of a strategy, an encoding, or a radio stands for a file, which is missing."""
    for setting, flag in (("strategy", "strategies"), ("map_encoding", "map-encodings"), ("radio", "radios")):
        parts = plugins.kinds()["radio.preset" if setting == "radio" else setting]
        if file in parts.built_in and not Path(file).exists():
            raise ScenarioError(
                f"{file!r}: is a {parts.kind}, not a scenario's file; use --{flag}, or in Python "
                f"{{{setting!r}: {file!r}}}"
            )


def _sentence(metric: str, finding: Finding) -> str:
    """The finding for a pair of settings, as a sentence."""
    one, other = finding.rule.compare[VARIANT], finding.rule.to[VARIANT]
    effect = finding.effect
    if not effect.n:
        why = f" ({finding.left_out} excluded as unfinished or 0)" if finding.left_out else ""
        return f"{one} and {other}: no pair of runs to compare{why}"
    bounds = "" if effect.low != effect.low else f" [{_ratio(effect.low)}, {_ratio(effect.high)}]"
    excluded = f", {finding.left_out} excluded as unfinished or 0" if finding.left_out else ""
    pairs = f"{effect.n} pairs{excluded}"
    text = f"{_ratio(effect.mean)}{bounds} times the {metric} of {other} (p = {finding.p:.3g}, {pairs})"
    if finding.verdict == UNDECIDED:
        return f"{one} and {other} have no significant difference: {one} has {text}"
    return f"{one} has {'less' if finding.verdict == HOLDS else 'more'} than {other}: {text}"


def _ratio(value: float) -> str:
    """A ratio with two decimals; below 0.1, with two significant digits."""
    return f"{value:.2f}" if value >= 0.1 else f"{value:.2g}"
