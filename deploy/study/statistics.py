"""Statistics of runs: means with intervals, quartiles, and paired tests.

Intervals are 95 % intervals by Student's t. Runs of compared settings share their seeds, so tests compare them in
pairs: positive metrics by the logarithm of their ratio, other metrics by their difference. A test yields two one-sided
p-values: for the expectation, and against it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

CONFIDENCE = 0.95
SIGNIFICANT = 0.05

Values = Sequence[float] | NDArray[np.float64]


@dataclass(frozen=True)
class Interval:
    """A mean with its 95 % interval; the bounds are NaN for fewer than two values, all three are for none."""

    n: int
    mean: float
    low: float
    high: float

    @property
    def half(self) -> float:
        """Half of the interval's width."""
        return (self.high - self.low) / 2


@dataclass(frozen=True)
class Evidence:
    """The evidence of values for or against an expectation."""

    effect: Interval
    """The tested mean, mean difference, geometric mean ratio, or mean rank correlation."""
    d: float
    """Effect size: the mean's distance from the bound, in standard deviations of the (paired) values."""
    p_for: float
    """One-sided p-value of the evidence for the expectation."""
    p_against: float
    """That of the evidence against it."""


NO_EVIDENCE = Evidence(Interval(0, math.nan, math.nan, math.nan), math.nan, 1.0, 1.0)
"""The evidence of no values."""


def interval(values: Values) -> Interval:
    """Mean and 95 % interval (Student's t)."""
    n = len(values)
    mean = float(np.mean(values)) if n else math.nan
    if n < 2:
        return Interval(n, mean, math.nan, math.nan)
    quantile = scipy.special.stdtrit(n - 1, 0.5 + CONFIDENCE / 2)
    half = float(quantile * (np.std(values, ddof=1) / math.sqrt(n)))
    return Interval(n, mean, mean - half, mean + half)


def five_numbers(values: Values) -> list[float]:
    """Minimum, lower quartile, median, upper quartile, maximum; NaN without values."""
    quantiles: list[float] = (
        np.quantile(values, (0, 0.25, 0.5, 0.75, 1)).tolist() if len(values) else 5 * [math.nan]
    )
    return quantiles


def share(successes: int, n: int) -> Interval:
    """A share with its 95 % interval (Wilson)."""
    if n == 0:
        return Interval(0, math.nan, math.nan, math.nan)
    bounds = scipy.stats.binomtest(successes, n).proportion_ci(CONFIDENCE, "wilson")
    return Interval(n, successes / n, float(bounds.low), float(bounds.high))


def mean_within(values: Values, low: float, high: float) -> Evidence:
    """Test whether the mean is above `low` and below `high`, which may be infinite, by one-sample t tests.

    If all values are 0 or 1, these are exact binomial tests instead.
    """
    data = np.asarray(values, float)
    if not (len(data) and set(np.unique(data)) <= {0.0, 1.0}):
        return _t_tests(data, low, high)
    ones, n = int(data.sum()), len(data)
    return _tests(share(ones, n), data, low, high, lambda bound, side: _binomial(ones, n, bound, side))


def difference_within(first: Values, second: Values, low: float, high: float) -> Evidence:
    """Test whether the mean difference of the pairs is above `low` and below `high`.

    If all values are 0 or 1 and a bound is 0, this is an exact sign test of the pairs that differ (McNemar).
    """
    one, other = np.asarray(first, float), np.asarray(second, float)
    differences = one - other
    if {0.0, 1.0} >= {*np.unique(one), *np.unique(other)} and len(one) and {low, high} & {0.0}:
        more, less = int((differences > 0).sum()), int((differences < 0).sum())
        up, down = (_binomial(count, more + less, 0.5, "greater") for count in (more, less))
        p_for, p_against = (up, down) if low == 0 else (down, up)
        return Evidence(interval(differences), _size(differences, low, high), p_for, p_against)
    return _t_tests(differences, low, high)


def ratio_within(first: Values, second: Values, low: float, high: float) -> Evidence:
    """Test whether the geometric mean ratio of the pairs is above `low` and below `high`, by t tests on logarithms.

    All values must be positive.
    """
    logs = np.log(np.asarray(first, float)) - np.log(np.asarray(second, float))
    test = _t_tests(logs, math.log(low) if low > 0 else -math.inf, math.log(high))
    mean, lowest, highest = (math.exp(log) for log in (test.effect.mean, test.effect.low, test.effect.high))
    return replace(test, effect=Interval(test.effect.n, mean, lowest, highest))


def trend(blocks: Sequence[Sequence[float]], sign: int) -> Evidence:
    """Test whether values grow (`sign` 1) or fall (-1) over ordered levels, by Page's test; a row is a block.

    The effect is Spearman's rank correlation with the order of the levels, averaged over blocks. The test needs at
    least three levels.
    """
    data = np.asarray(blocks, float)
    if not len(data):
        return NO_EVIDENCE
    order = np.arange(data.shape[1])
    ranks = scipy.stats.rankdata(data, axis=1)
    steady = ranks.std(axis=1) == 0
    correlations = np.array(
        [0.0 if flat else np.corrcoef(order, row)[0, 1] for row, flat in zip(ranks, steady, strict=True)]
    )
    p_grows, p_falls = (
        1.0 if steady.all() else float(scipy.stats.page_trend_test(values).pvalue)
        for values in (data, data[:, ::-1])
    )
    p_for, p_against = (p_grows, p_falls) if sign > 0 else (p_falls, p_grows)
    return Evidence(interval(correlations), _size(correlations, 0, math.inf), p_for, p_against)


def same_order(values: Sequence[float], reference: Sequence[float]) -> Evidence:
    """Test whether values have the same order as the reference values, by the exact test of Kendall's tau."""
    up, down = (scipy.stats.kendalltau(values, reference, alternative=side) for side in ("greater", "less"))
    tau = float(up.statistic)
    return Evidence(Interval(len(values), tau, math.nan, math.nan), tau, float(up.pvalue), float(down.pvalue))


def holm(p_values: Sequence[float]) -> list[float]:
    """Correct p-values for their number (Holm); keeps the order."""
    order = np.argsort(p_values, kind="stable")
    factors = np.arange(len(p_values), 0, -1)
    corrected = np.empty(len(p_values))
    corrected[order] = np.minimum(1, np.maximum.accumulate(factors * np.asarray(p_values)[order]))
    result: list[float] = corrected.tolist()
    return result


def _tests(
    effect: Interval,
    data: NDArray[np.float64],
    low: float,
    high: float,
    p_value: Callable[[float, str], float],
) -> Evidence:
    """The evidence from one-sided tests of both bounds; `p_value` tests a bound with alternative greater or less."""
    p_for = max(p_value(low, "greater"), p_value(high, "less"))
    p_against = min(p_value(low, "less"), p_value(high, "greater"))
    return Evidence(effect, _size(data, low, high), p_for, p_against)


def _t_tests(data: NDArray[np.float64], low: float, high: float) -> Evidence:
    return _tests(interval(data), data, low, high, lambda bound, side: _t(data, bound, side))


def _t(data: NDArray[np.float64], bound: float, side: str) -> float:
    """One-sided p-value; by a sign test if the values have no variance. Infinite bounds are certainly met or missed."""
    sign = 1 if side == "greater" else -1
    if math.isinf(bound):
        return float(sign * bound > 0)
    if len(data) < 2:
        return 1.0
    beyond = sign * (data - bound)
    if beyond.std() <= 1e-12 * max(1.0, float(np.abs(beyond).max())):
        return 0.5 ** len(beyond) if np.round(beyond.mean(), 12) > 0 else 1.0
    return float(scipy.stats.ttest_1samp(beyond, 0, alternative="greater").pvalue)


def _binomial(successes: int, n: int, probability: float, side: str) -> float:
    """Exact one-sided p-value; bounds outside (0, 1) are certainly met or missed."""
    if not 0 < probability < 1:
        met = probability <= 0 if side == "greater" else probability >= 1
        return 0.0 if met and n else 1.0
    return float(scipy.stats.binomtest(successes, n, probability, alternative=side).pvalue) if n else 1.0


def _size(data: NDArray[np.float64], low: float, high: float) -> float:
    """Distance of the mean from the nearest bound, in standard deviations."""
    if len(data) < 2:
        return math.nan
    bound = min((b for b in (low, high) if math.isfinite(b)), key=lambda b: abs(float(data.mean()) - b))
    spread = float(data.std(ddof=1))
    distance = float(data.mean()) - bound
    return distance / spread if spread > 0 else math.copysign(math.inf, distance) if distance else 0.0
