"""A claim of a paper: rules that runs are tested against, and the verdict that follows from the tests.

A rule is data, in the experiment's file. It names a figure and what is expected of it, and is tested apart for each
combination of the keys ``by`` (all runs together without), on the runs that ``where`` leaves::

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
``difference > 0``                    mean difference of paired runs, t test; sign test if all figures are 0 or 1
``value < 0.5``, ``value in 0..0.1``  mean, t test; exact binomial test if all figures are 0 or 1
``falls over KEY``, ``grows over KEY``  trend over the key's values in the grid's order, Page's test
``order of KEY``                      the same order as ``ranks = { value = number, ... }``, Kendall's tau, exact
====================================  =========================================================================

Paired runs are equal in all but the keys of ``compare``. ``spread of`` before a figure means its distance from the
median of its side and cell. Runs that did not finish (`deploy.study.tables.has_finished`) are left out, with their
partners, unless ``all_runs = true``; a figure of which the rule says ``exact = true`` does not vary by chance and
is compared as it is.

P-values are corrected for the number of tests of the claim (Holm). A test is decided if the corrected two-sided p
is below 0.05. The claim *holds* if all its tests do, *does not hold* if some are decided against it and none for
it, is *undecided* if none is decided, and *holds in part* otherwise.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from deploy.study import statistics
from deploy.study.results import Row
from deploy.study.statistics import SIGNIFICANT, Evidence, Interval
from deploy.study.tables import VARIANT, check, figure, has_finished, key_of

HOLDS, IN_PART, NOT, UNDECIDED = "holds", "holds in part", "does not hold", "undecided"

SPREAD = "spread of "

NUMBER = r"[-+]?\d+(?:\.\d+)?"
BOUND = re.compile(rf"(ratio|difference|value) (?:(<|>) ({NUMBER})|in ({NUMBER})\.\.({NUMBER}))")
TREND = re.compile(r"(falls|grows) over (\S+)")
ORDER = re.compile(r"order of (\S+)")

FORMS = "'ratio < 1', 'difference > 0', 'value in 0..0.1', 'falls over robots', 'grows over robots', 'order of map'"


@dataclass(frozen=True)
class Rule:
    """What a claim expects of a figure; see the file's head."""

    statement: str
    metric: str
    expect: str
    compare: dict[str, Any]
    to: dict[str, Any]
    by: list[str]
    where: dict[str, list[Any]]
    ranks: dict[str, float]
    all_runs: bool
    exact: bool


@dataclass(frozen=True)
class Claim:
    """What a paper claims, and what would show it.

    Attributes
    ----------
    id : str
        As ``B1``; several experiments may bring rules for a claim.
    paper, figure : str
        Where it stands.
    statement : str
        The claim in a sentence.
    reported : str
        The paper's own figures.
    explanation : str
        Why it comes out differently here, where it does; found by experiment. Not the verdict: that is computed.
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
        What was found.
    d : float
        Effect size, in standard deviations.
    p : float
        Two-sided, corrected.
    left_out : int
        Runs or pairs of which one did not finish.
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
    """The verdict on a claim, and the findings that it follows from."""

    word: str
    findings: list[Finding]

    @property
    def counts(self) -> str:
        """How many tests came out how."""
        words = [finding.verdict for finding in self.findings]
        named = ((HOLDS, "as expected"), (NOT, "against it"), (UNDECIDED, "undecided"))
        return ", ".join(f"{words.count(word)} {said}" for word, said in named if word in words) or "no tests"


def read_claim(data: Any, grid: dict[str, Any], variants: Iterable[str], names: Iterable[str]) -> Claim:
    """Check a claim as read from a file; ValueError says what is wrong. `names` are figures besides a summary's."""
    texts = ("id", "paper", "figure", "statement", "reported", "explanation")
    if not isinstance(data, dict):
        raise ValueError(f"claim = {data!r}: must be a table, [claim]")
    for key, value in data.items():
        if key not in (*texts, "rule"):
            raise ValueError(f"claim.{key} is no part of a claim; there are: {', '.join((*texts, 'rule'))}")
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
    said = {key: " ".join(data.get(key, "").split()) for key in texts}
    return Claim(**said, rules=rules)


def judge(parts: Iterable[tuple[Sequence[Rule], Sequence[Row]]]) -> Verdict:
    """Test rules on the runs of their experiment and combine all that is found into a verdict."""
    tests = [test for rules, rows in parts for rule in rules for test in _tests(rule, rows)]
    return Verdict(*_decided(tests))


def combined(findings: Iterable[Finding]) -> str:
    """The verdict that follows from findings."""
    words = {finding.verdict for finding in findings}
    if words <= {UNDECIDED}:
        return UNDECIDED
    if words == {HOLDS}:
        return HOLDS
    return IN_PART if HOLDS in words else NOT


class _Test(NamedTuple):
    rule: Rule
    cell: dict[str, Any]
    evidence: Evidence
    left_out: int


def _decided(tests: Sequence[_Test]) -> tuple[str, list[Finding]]:
    two_sided = [min(1.0, 2 * min(test.evidence.p_for, test.evidence.p_against)) for test in tests]
    findings = []
    for test, p in zip(tests, statistics.holm(two_sided), strict=True):
        word = UNDECIDED
        if p < SIGNIFICANT:
            word = HOLDS if test.evidence.p_for < test.evidence.p_against else NOT
        findings.append(
            Finding(test.rule, test.cell, test.evidence.effect, test.evidence.d, p, test.left_out, word)
        )
    return combined(findings), findings


def _tests(rule: Rule, rows: Sequence[Row]) -> list[_Test]:
    """A rule's tests, one for each of its cells."""
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
    """What the runs of a cell say, and how many were left out."""
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
        figures = [one / other if kind == "ratio" else one - other for one, other in whole]
        return _exactly(figures, least, most), len(pairs) - len(whole)
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


def _exactly(figures: Sequence[float], least: float, most: float) -> Evidence:
    """All figures must lie within the bounds; there is no chance in them."""
    if not figures:
        return Evidence(statistics.interval([]), math.nan, 1.0, 1.0)
    within = all(least < value < most for value in figures)
    effect = Interval(len(figures), float(np.mean(figures)), min(figures), max(figures))
    return Evidence(effect, math.nan, 0.0 if within else 1.0, 1.0 if within else 0.0)


def _side(rows: Sequence[Row], choice: dict[str, Any]) -> list[Row]:
    return [row for row in rows if all(row["place"].get(key) == value for key, value in choice.items())]


def _values(
    rule: Rule,
    rows: Sequence[Row],
    apart: set[str] = frozenset(),  # type: ignore[assignment]
) -> dict[Any, float | None]:
    """The figure of each run, by its place without the keys `apart`; None where the run does not count."""
    name = rule.metric.removeprefix(SPREAD)
    values: dict[Any, float | None] = {}
    for row in rows:
        place = {key: value for key, value in row["place"].items() if key not in apart}
        counts = rule.all_runs or has_finished(row)
        values[key_of(place)] = figure(row, name) if counts else None
    if name != rule.metric:
        there = [value for value in values.values() if value is not None]
        middle = float(np.median(there)) if there else math.nan
        return {key: None if value is None else abs(value - middle) for key, value in values.items()}
    return values


def _rule(entry: Any, keys: set[str], variants: list[str], names: list[str]) -> Rule:
    """Check a rule; ValueError says what is wrong."""
    rule = replace(
        Rule("", "", "", {}, {}, [], {}, {}, all_runs=False, exact=False), **_known(entry, keys, variants)
    )
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
        raise ValueError(f"{where}: compare and to say what a ratio or a difference is of, and nothing else")
    if paired and set(rule.compare) != set(rule.to):
        raise ValueError(f"{where}: compare and to must name the same keys")
    over = trend[2] if trend else order[1] if order else None
    if over is not None and over not in keys:
        raise ValueError(f"{where}: {over!r} is not in the grid; there are: {', '.join(sorted(keys))}")
    if bool(order) != bool(rule.ranks):
        raise ValueError(f"{where}: ranks says which order is expected, as {{ a = 1, b = 2 }}")
    return rule


def _known(entry: Any, keys: set[str], variants: list[str]) -> dict[str, Any]:
    """A rule's keys, each of the right kind; ValueError says what is wrong."""
    kinds = Rule.__annotations__
    if not isinstance(entry, dict):
        raise ValueError(f"claim.rule = {entry!r}: must be tables, [[claim.rule]]")
    given: dict[str, Any] = entry
    for key, value in given.items():
        if key not in kinds:
            raise ValueError(f"claim.rule.{key} is no part of a rule; there are: {', '.join(kinds)}")
        kind: type = {"str": str, "bool": bool, "list[str]": list}.get(kinds[key], dict)
        if not issubclass(type(value), kind):
            raise ValueError(f"claim.rule.{key} = {value!r}: must be of kind {kind.__name__}")
        if key in ("compare", "to", "where", "by"):
            for name in value:
                if name not in keys:
                    raise ValueError(
                        f"claim.rule.{key} speaks of {name!r}, which is not in the grid; there are: "
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
