"""A claim of a paper: rules that are tested on runs, and the verdict that follows from the tests.

An experiment's file contains the rules. A rule names a metric and an expectation. There is one test per combination of
the keys ``by`` (a single test without ``by``), on the runs that ``where`` selects::

    [[claim.rule]]
    statement = "coordinated robots are faster"
    metric = "steps"
    compare = { variant = "burgard" }
    to = { variant = "nearest" }
    expect = "ratio < 1"
    by = ["map", "robots"]
    where = { robots = [2, 3, 5] }

====================================  =========================================================================
expect                                test
====================================  =========================================================================
``ratio < 1``, ``ratio in 0.9..1.1``  geometric mean of the ratios of paired runs, t test on their logarithms
``difference > 0``                    mean difference of paired runs, t test; sign test if all values are 0 or 1
``value < 0.5``, ``value in 0..0.1``  mean, t test; exact binomial test if all values are 0 or 1
``falls over KEY``, ``grows over KEY``  trend over the key's values in the grid's order, Page's test
``order of KEY``                      the same order as ``ranks = { value = number, ... }``, Kendall's tau, exact
====================================  =========================================================================

Paired runs differ only in the keys of ``compare``. ``spread of`` before a metric means its distance from the median of
its side and cell. Runs that did not finish (`deploy.study.tables.has_finished`) are excluded with their partners,
unless ``all_runs = true``. With ``exact = true`` the metric does not vary randomly and is compared directly.

P-values are corrected for the number of tests of the claim (Holm). A test is decided if its corrected two-sided p-value
is below 0.05. The claim *holds* if all its tests do. It *does not hold* if some tests are decided against it and none
for it. It is *undecided* if no test is decided, and *holds in part* otherwise.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from deploy.study import statistics
from deploy.study.results import PLACE, Row
from deploy.study.statistics import NO_EVIDENCE, SIGNIFICANT, Evidence, Interval
from deploy.study.tables import VARIANT, check, check_keys, has_finished, key_of, levels_of, metric_value

HOLDS, IN_PART, NOT, UNDECIDED = "holds", "holds in part", "does not hold", "undecided"

SPREAD = "spread of "

NUMBER = r"[-+]?\d+(?:\.\d+)?"
BOUND = re.compile(rf"(ratio|difference|value) (?:(<|>) ({NUMBER})|in ({NUMBER})\.\.({NUMBER}))")
OVER = re.compile(r"(falls over|grows over|order of) (\S+)")

FORMS = "'ratio < 1', 'difference > 0', 'value in 0..0.1', 'falls over robots', 'grows over robots', 'order of map'"


class Expectation(NamedTuple):
    """An expectation: its first words, the bounds of a ratio, difference or value, and the key of all others."""

    kind: str
    low: float = -math.inf
    high: float = math.inf
    key: str = ""


@dataclass(frozen=True)
class Rule:
    """The expectation of a claim for a metric; see the module's description."""

    statement: str
    metric: str
    expect: str
    compare: dict[str, Any] = field(default_factory=dict)
    to: dict[str, Any] = field(default_factory=dict)
    by: list[str] = field(default_factory=list)
    where: dict[str, list[Any]] = field(default_factory=dict)
    ranks: dict[str, float] = field(default_factory=dict)
    all_runs: bool = False
    exact: bool = False

    def __post_init__(self) -> None:
        paired = self.expectation.kind in ("ratio", "difference")
        if paired != bool(self.compare) or paired != bool(self.to):
            raise ValueError("compare and to are needed for a ratio or a difference, and for nothing else")
        if self.compare.keys() != self.to.keys():
            raise ValueError("compare and to must name the same keys")
        if (self.expectation.kind == "order of") != bool(self.ranks):
            raise ValueError("ranks gives the expected order, as { a = 1, b = 2 }")

    @property
    def expectation(self) -> Expectation:
        """The parsed ``expect``."""
        if over := OVER.fullmatch(self.expect):
            return Expectation(over[1], key=over[2])
        if bound := BOUND.fullmatch(self.expect):
            kind, sign, single, low, high = bound.groups()
            low, high = low or (single if sign == ">" else "-inf"), high or (single if sign == "<" else "inf")
            return Expectation(kind, float(low), float(high))
        raise ValueError(f"expect = {self.expect!r}: must be one of {FORMS}")


Text = Annotated[str, AfterValidator(lambda text: " ".join(text.split()))]
"""Text whose line breaks do not count."""


@dataclass(frozen=True)
class Claim:
    """A claim of a paper, with the rules that test it."""

    id: Text
    """As ``B1``; several experiments may contribute rules to a claim."""
    paper: Text
    statement: Text
    rule: Annotated[list[Rule], Field(min_length=1)]
    figure: Text = ""
    """Figure, table or section of the paper."""
    reported: Text = ""
    """The results of the paper."""
    explanation: Text = ""
    """Why the results differ from the paper, found by experiment; the verdict itself is computed."""


@dataclass(frozen=True)
class Finding:
    """The outcome of a rule's test."""

    rule: Rule
    cell: dict[str, Any]
    """Values of the rule's ``by``."""
    effect: Interval
    d: float
    """Effect size, in standard deviations."""
    p: float
    """Corrected two-sided p-value."""
    left_out: int
    """Number of excluded runs or pairs."""
    verdict: str
    """`HOLDS`, `NOT` or `UNDECIDED`."""


class Verdict(NamedTuple):
    """The verdict on a claim, and the findings from which it follows."""

    result: str
    findings: list[Finding]

    @property
    def counts(self) -> str:
        """The number of tests of each verdict, as text."""
        verdicts = [finding.verdict for finding in self.findings]
        named = ((HOLDS, "as expected"), (NOT, "against it"), (UNDECIDED, "undecided"))
        counts = [f"{verdicts.count(verdict)} {name}" for verdict, name in named if verdict in verdicts]
        return ", ".join(counts) or "no tests"


def check_claim(claim: Claim, grid: Iterable[str], variants: Collection[str], metrics: Iterable[str]) -> None:
    """Raise ValueError if a rule names a key, a variant or a metric that its experiment does not have."""
    for rule in claim.rule:
        key = rule.expectation.key
        named = [*rule.compare, *rule.to, *rule.by, *rule.where, *([key] if key else [])]
        check_keys(f"claim.rule {rule.statement!r}", named, grid)
        for choice in (rule.compare, rule.to):
            if choice.get(VARIANT, next(iter(variants))) not in variants:
                raise ValueError(
                    f"claim.rule {rule.statement!r}: no variant is called {choice[VARIANT]!r}; "
                    f"there are: {', '.join(variants)}"
                )
        check(rule.metric.removeprefix(SPREAD), (), metrics)


def judge(parts: Iterable[tuple[Sequence[Rule], Sequence[Row]]]) -> Verdict:
    """Test rules on the runs of their experiments; return the verdict."""
    tests = [test for rules, rows in parts for rule in rules for test in _tests(rule, rows)]
    two_sided = [min(1.0, 2 * min(found.p_for, found.p_against)) for _, _, found, _ in tests]
    findings = []
    for (rule, cell, evidence, left_out), p in zip(tests, statistics.holm(two_sided), strict=True):
        verdict = UNDECIDED
        if p < SIGNIFICANT:
            verdict = HOLDS if evidence.p_for < evidence.p_against else NOT
        findings.append(Finding(rule, cell, evidence.effect, evidence.d, p, left_out, verdict))
    return Verdict(combined(findings), findings)


def combined(findings: Iterable[Finding]) -> str:
    """Combine findings into a verdict."""
    verdicts = {finding.verdict for finding in findings}
    if verdicts <= {UNDECIDED}:
        return UNDECIDED
    if verdicts == {HOLDS}:
        return HOLDS
    return IN_PART if HOLDS in verdicts else NOT


def _tests(rule: Rule, rows: Sequence[Row]) -> list[tuple[Rule, dict[str, Any], Evidence, int]]:
    """The tests of a rule, one per cell: the rule, the cell, the evidence, and the number of excluded runs or pairs."""
    cells: dict[str, tuple[dict[str, Any], list[Row]]] = {}
    for row in rows:
        if all(row[PLACE].get(key) in values for key, values in rule.where.items()):
            cell = {key: row[PLACE][key] for key in rule.by}
            cells.setdefault(repr(cell), (cell, []))[1].append(row)
    if not cells:
        return [(rule, {}, NO_EVIDENCE, 0)]
    return [(rule, cell, *_evidence(rule, members)) for cell, members in cells.values()]


def _evidence(rule: Rule, rows: Sequence[Row]) -> tuple[Evidence, int]:
    """The evidence of a cell's runs, and the number of excluded runs or pairs."""
    kind, low, high, key = rule.expectation
    if kind == "order of":
        return _order(rule, rows, key)
    if key:
        return _trend(rule, rows, key, 1 if kind == "grows over" else -1)
    if kind == "value":
        runs = [[value] for value in _values(rule, rows).values()]
    else:
        first, second = (
            _values(rule, _side(rows, side), set(rule.compare)) for side in (rule.compare, rule.to)
        )
        runs = [[value, second.get(place)] for place, value in first.items()]
    whole = [[value for value in run if value is not None] for run in runs if None not in run]
    whole = [run for run in whole if kind != "ratio" or min(run) > 0]
    columns = np.array(whole).reshape(-1, 1 if kind == "value" else 2).T
    left_out = len(runs) - len(whole)
    if rule.exact:
        combine = {"ratio": np.divide, "difference": np.subtract}.get(kind, np.positive)
        return _exactly(combine(*columns), low, high), left_out
    if kind == "value":
        return statistics.mean_within(columns[0], low, high), left_out
    test = statistics.ratio_within if kind == "ratio" else statistics.difference_within
    return test(columns[0], columns[1], low, high), left_out


def _trend(rule: Rule, rows: Sequence[Row], key: str, sign: int) -> tuple[Evidence, int]:
    found = [_values(rule, _side(rows, {key: level}), {key}) for level in levels_of(rows, key)]
    places = dict.fromkeys(place for of_level in found for place in of_level)
    blocks = [[of_level.get(place) for of_level in found] for place in places]
    whole = [[value for value in block if value is not None] for block in blocks if None not in block]
    if len(found) < 3:
        whole = []
    return statistics.trend(whole, sign), len(blocks) - len(whole)


def _order(rule: Rule, rows: Sequence[Row], key: str) -> tuple[Evidence, int]:
    found, wanted = [], []
    for level, rank in rule.ranks.items():
        of_level = [row for row in rows if level in (str(row[PLACE][key]), Path(str(row[PLACE][key])).stem)]
        values = [value for value in _values(rule, of_level).values() if value is not None]
        if values:
            found.append(float(np.mean(values)))
            wanted.append(rank)
    evidence = statistics.same_order(found, wanted) if len(found) > 1 else NO_EVIDENCE
    return evidence, len(rule.ranks) - len(found)


def _exactly(values: NDArray[np.float64], low: float, high: float) -> Evidence:
    """Compare values without random variation: all must lie within the bounds."""
    if not len(values):
        return NO_EVIDENCE
    within = bool(((low < values) & (values < high)).all())
    effect = Interval(len(values), float(values.mean()), float(values.min()), float(values.max()))
    return Evidence(effect, math.nan, float(not within), float(within))


def _side(rows: Sequence[Row], choice: dict[str, Any]) -> list[Row]:
    return [row for row in rows if all(row[PLACE].get(key) == value for key, value in choice.items())]


def _values(
    rule: Rule, rows: Sequence[Row], ignored: Collection[str] = frozenset()
) -> dict[Any, float | None]:
    """The metric of each run, by its place without the `ignored` keys; None if the run is excluded."""
    name = rule.metric.removeprefix(SPREAD)
    values: dict[Any, float | None] = {}
    for row in rows:
        place = {key: value for key, value in row[PLACE].items() if key not in ignored}
        counts = rule.all_runs or has_finished(row)
        values[key_of(place)] = metric_value(row, name) if counts else None
    if name != rule.metric:
        there = [value for value in values.values() if value is not None]
        middle = float(np.median(there)) if there else math.nan
        return {key: None if value is None else abs(value - middle) for key, value in values.items()}
    return values
