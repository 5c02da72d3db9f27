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
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from deploy.study import statistics
from deploy.study.results import Row
from deploy.study.statistics import SIGNIFICANT, Evidence, Interval
from deploy.study.tables import VARIANT, check, has_finished, key_of, metric_value

HOLDS, IN_PART, NOT, UNDECIDED = "holds", "holds in part", "does not hold", "undecided"

SPREAD = "spread of "

NUMBER = r"[-+]?\d+(?:\.\d+)?"
BOUND = re.compile(rf"(ratio|difference|value) (?:(<|>) ({NUMBER})|in ({NUMBER})\.\.({NUMBER}))")
TREND = re.compile(r"(falls|grows) over (\S+)")
ORDER = re.compile(r"order of (\S+)")

FORMS = "'ratio < 1', 'difference > 0', 'value in 0..0.1', 'falls over robots', 'grows over robots', 'order of map'"


@dataclass(frozen=True)
class Rule:
    """The expectation of a claim for a metric; see the module's description."""

    statement: str = ""
    metric: str = ""
    expect: str = ""
    compare: dict[str, Any] = field(default_factory=dict)
    to: dict[str, Any] = field(default_factory=dict)
    by: list[str] = field(default_factory=list)
    where: dict[str, list[Any]] = field(default_factory=dict)
    ranks: dict[str, float] = field(default_factory=dict)
    all_runs: bool = False
    exact: bool = False


@dataclass(frozen=True)
class Claim:
    """A claim of a paper, with the rules that test it.

    Attributes
    ----------
    id : str
        As ``B1``; several experiments may contribute rules to a claim.
    paper, figure : str
        Its source.
    statement : str
        The claim in a sentence.
    reported : str
        The results of the paper.
    explanation : str
        Why the results differ from the paper, found by experiment; the verdict itself is computed.
    rules : tuple of Rule
    """

    id: str
    paper: str
    figure: str
    statement: str
    reported: str
    explanation: str
    rules: tuple[Rule, ...]


@dataclass(frozen=True)
class Finding:
    """The outcome of a rule's test.

    Attributes
    ----------
    rule : Rule
    cell : dict
        Values of the rule's ``by``.
    effect : Interval
        The tested effect.
    d : float
        Effect size, in standard deviations.
    p : float
        Corrected two-sided p-value.
    left_out : int
        Number of excluded runs or pairs.
    verdict : str
        `HOLDS`, `NOT` or `UNDECIDED`.
    """

    rule: Rule
    cell: dict[str, Any]
    effect: Interval
    d: float
    p: float
    left_out: int
    verdict: str


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


def read_claim(data: Any, grid: dict[str, Any], variants: Iterable[str], names: Iterable[str]) -> Claim:
    """Check a claim as read from a file; ValueError if it is invalid. `names` are the metrics of the measure."""
    texts = ("id", "paper", "figure", "statement", "reported", "explanation")
    if not isinstance(data, dict):
        raise ValueError(f"claim = {data!r}: must be a table, [claim]")
    for key, value in data.items():
        if key not in (*texts, "rule"):
            raise ValueError(f"claim.{key} is not a key of a claim; there are: {', '.join((*texts, 'rule'))}")
        if key in texts and not isinstance(value, str):
            raise ValueError(f"claim.{key} = {value!r}: must be text")
    for key in ("id", "paper", "statement"):
        if not data.get(key):
            raise ValueError(f"claim.{key} is missing")
    entries = data.get("rule", [])
    if not isinstance(entries, list) or not entries:
        raise ValueError("claim.rule: a claim needs rules, [[claim.rule]]")
    keys, variants, names = {*grid, VARIANT}, list(variants), list(names)
    rules = tuple(_rule(entry, keys, variants, names) for entry in entries)
    cleaned = {key: " ".join(data.get(key, "").split()) for key in texts}
    return Claim(**cleaned, rules=rules)


def judge(parts: Iterable[tuple[Sequence[Rule], Sequence[Row]]]) -> Verdict:
    """Test rules on the runs of their experiments; return the verdict."""
    tests = [test for rules, rows in parts for rule in rules for test in _tests(rule, rows)]
    return Verdict(*_decided(tests))


def combined(findings: Iterable[Finding]) -> str:
    """Combine findings into a verdict."""
    verdicts = {finding.verdict for finding in findings}
    if verdicts <= {UNDECIDED}:
        return UNDECIDED
    if verdicts == {HOLDS}:
        return HOLDS
    return IN_PART if HOLDS in verdicts else NOT


class _Test(NamedTuple):
    rule: Rule
    cell: dict[str, Any]
    evidence: Evidence
    left_out: int


def _decided(tests: Sequence[_Test]) -> tuple[str, list[Finding]]:
    two_sided = [min(1.0, 2 * min(test.evidence.p_for, test.evidence.p_against)) for test in tests]
    findings = []
    for test, p in zip(tests, statistics.holm(two_sided), strict=True):
        verdict = UNDECIDED
        if p < SIGNIFICANT:
            verdict = HOLDS if test.evidence.p_for < test.evidence.p_against else NOT
        findings.append(
            Finding(test.rule, test.cell, test.evidence.effect, test.evidence.d, p, test.left_out, verdict)
        )
    return combined(findings), findings


def _tests(rule: Rule, rows: Sequence[Row]) -> list[_Test]:
    """The tests of a rule, one per cell."""
    chosen = [
        row for row in rows if all(row["place"].get(key) in values for key, values in rule.where.items())
    ]
    cells: dict[str, tuple[dict[str, Any], list[Row]]] = {}
    for row in chosen:
        cell = {key: row["place"][key] for key in rule.by}
        cells.setdefault(repr(cell), (cell, []))[1].append(row)
    if not cells:
        return [_Test(rule, {}, Evidence(statistics.interval([]), math.nan, 1.0, 1.0), 0)]
    return [_Test(rule, cell, *_evidence(rule, members)) for cell, members in cells.values()]


def _evidence(rule: Rule, rows: Sequence[Row]) -> tuple[Evidence, int]:
    """The evidence of a cell's runs, and the number of excluded runs."""
    if trend := TREND.fullmatch(rule.expect):
        return _trend(rule, rows, trend[2], 1 if trend[1] == "grows" else -1)
    if order := ORDER.fullmatch(rule.expect):
        return _order(rule, rows, order[1])
    bound = BOUND.fullmatch(rule.expect)
    assert bound is not None
    kind, sign, single, low, high = bound.groups()
    least = float(low) if low else float(single) if sign == ">" else -math.inf
    most = float(high) if high else float(single) if sign == "<" else math.inf
    if kind == "value":
        values = _values(rule, rows)
        found = [value for value in values.values() if value is not None]
        left_out = len(rows) - len(found)
        return _exactly(found, least, most) if rule.exact else statistics.mean_within(
            found, least, most
        ), left_out
    first = _values(rule, _side(rows, rule.compare), set(rule.compare))
    second = _values(rule, _side(rows, rule.to), set(rule.compare))
    pairs = [(first[key], second.get(key)) for key in first]
    whole = [(one, other) for one, other in pairs if one is not None and other is not None]
    if kind == "ratio":
        whole = [(one, other) for one, other in whole if one > 0 and other > 0]
    ones, others = [one for one, _ in whole], [other for _, other in whole]
    test: Callable[..., Evidence] = (
        statistics.ratio_within if kind == "ratio" else statistics.difference_within
    )
    if rule.exact:
        found = [one / other if kind == "ratio" else one - other for one, other in whole]
        return _exactly(found, least, most), len(pairs) - len(whole)
    return test(ones, others, least, most), len(pairs) - len(whole)


def _trend(rule: Rule, rows: Sequence[Row], key: str, sign: int) -> tuple[Evidence, int]:
    levels = list({repr(row["place"][key]): row["place"][key] for row in rows}.values())
    blocks: dict[Any, dict[str, float | None]] = {}
    for level in levels:
        for block, value in _values(rule, _side(rows, {key: level}), {key}).items():
            blocks.setdefault(block, {})[repr(level)] = value
    whole = [
        [float(value) for value in block.values() if value is not None]
        for block in blocks.values()
        if len(block) == len(levels) and None not in block.values()
    ]
    if len(levels) < 3:
        whole = []
    return statistics.trend(whole, sign), len(blocks) - len(whole)


def _order(rule: Rule, rows: Sequence[Row], key: str) -> tuple[Evidence, int]:
    found, wanted = [], []
    for level, rank in rule.ranks.items():
        of_level = [
            row for row in rows if level in (str(row["place"][key]), Path(str(row["place"][key])).stem)
        ]
        values = [value for value in _values(rule, of_level).values() if value is not None]
        if values:
            found.append(float(np.mean(values)))
            wanted.append(rank)
    if len(found) < 2:
        return Evidence(statistics.interval([]), math.nan, 1.0, 1.0), len(rule.ranks) - len(found)
    return statistics.same_order(found, wanted), len(rule.ranks) - len(found)


def _exactly(values: Sequence[float], least: float, most: float) -> Evidence:
    """Compare values without random variation: all must lie within the bounds."""
    if not values:
        return Evidence(statistics.interval([]), math.nan, 1.0, 1.0)
    within = all(least < value < most for value in values)
    effect = Interval(len(values), float(np.mean(values)), min(values), max(values))
    return Evidence(effect, math.nan, 0.0 if within else 1.0, 1.0 if within else 0.0)


def _side(rows: Sequence[Row], choice: dict[str, Any]) -> list[Row]:
    return [row for row in rows if all(row["place"].get(key) == value for key, value in choice.items())]


def _values(
    rule: Rule,
    rows: Sequence[Row],
    ignored: set[str] = frozenset(),  # type: ignore[assignment]
) -> dict[Any, float | None]:
    """The metric of each run, by its place without the `ignored` keys; None if the run is excluded."""
    name = rule.metric.removeprefix(SPREAD)
    values: dict[Any, float | None] = {}
    for row in rows:
        place = {key: value for key, value in row["place"].items() if key not in ignored}
        counts = rule.all_runs or has_finished(row)
        values[key_of(place)] = metric_value(row, name) if counts else None
    if name != rule.metric:
        there = [value for value in values.values() if value is not None]
        middle = float(np.median(there)) if there else math.nan
        return {key: None if value is None else abs(value - middle) for key, value in values.items()}
    return values


def _rule(entry: Any, keys: set[str], variants: list[str], names: list[str]) -> Rule:
    """Check a rule; ValueError if it is invalid."""
    rule = Rule(**_checked(entry, keys, variants))
    where = f"claim.rule {rule.statement!r}"
    for key in ("statement", "metric", "expect"):
        if not getattr(rule, key):
            raise ValueError(f"{where}: {key} is missing")
    check(rule.metric.removeprefix(SPREAD), (), names)
    bound, trend, order = (form.fullmatch(rule.expect) for form in (BOUND, TREND, ORDER))
    if not (bound or trend or order):
        raise ValueError(f"{where}: expect = {rule.expect!r}: must be one of {FORMS}")
    paired = bound is not None and bound[1] != "value"
    if paired != bool(rule.compare) or paired != bool(rule.to):
        raise ValueError(
            f"{where}: compare and to are needed for a ratio or a difference, and for nothing else"
        )
    if paired and set(rule.compare) != set(rule.to):
        raise ValueError(f"{where}: compare and to must name the same keys")
    over = trend[2] if trend else order[1] if order else None
    if over is not None and over not in keys:
        raise ValueError(f"{where}: {over!r} is not in the grid; there are: {', '.join(sorted(keys))}")
    if bool(order) != bool(rule.ranks):
        raise ValueError(f"{where}: ranks gives the expected order, as {{ a = 1, b = 2 }}")
    return rule


def _checked(entry: Any, keys: set[str], variants: list[str]) -> dict[str, Any]:
    """A rule's keys, each of the right kind; ValueError if it is invalid."""
    kinds = Rule.__annotations__
    if not isinstance(entry, dict):
        raise ValueError(f"claim.rule = {entry!r}: must be tables, [[claim.rule]]")
    given: dict[str, Any] = entry
    for key, value in given.items():
        if key not in kinds:
            raise ValueError(f"claim.rule.{key} is not a key of a rule; there are: {', '.join(kinds)}")
        kind: type = {"str": str, "bool": bool, "list[str]": list}.get(kinds[key], dict)
        if not issubclass(type(value), kind):
            raise ValueError(f"claim.rule.{key} = {value!r}: must be a {kind.__name__}")
        if key in ("compare", "to", "where", "by"):
            for name in value:
                if name not in keys:
                    raise ValueError(
                        f"claim.rule.{key} names {name!r}, which is not in the grid; there are: "
                        f"{', '.join(sorted(keys))}"
                    )
    for key in ("compare", "to"):
        choice: dict[str, Any] = given.get(key, {})
        name = choice.get(VARIANT, variants[0])
        if name not in variants:
            raise ValueError(
                f"claim.rule.{key}: no variant is called {name!r}; there are: {', '.join(variants)}"
            )
    where: dict[str, Any] = given.get("where", {})
    for key, value in where.items():
        if not isinstance(value, list):
            raise ValueError(f"claim.rule.where.{key} = {value!r}: must be a list of values, as [3, 5]")
    return given
