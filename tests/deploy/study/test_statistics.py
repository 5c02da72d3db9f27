"""Statistics: intervals, paired tests and corrections, against figures from textbooks and by hand."""

from __future__ import annotations

import math
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from deploy.study import statistics

INF = math.inf


def test_an_interval_is_student_s() -> None:
    found = statistics.interval([40, 50, 60])
    assert (found.n, found.mean) == (3, 50)
    assert found.half == pytest.approx(4.303 * 10 / math.sqrt(3), rel=1e-3)
    assert math.isnan(statistics.interval([3]).low) and statistics.interval([]).n == 0


def test_intervals_do_without_the_tests_of_scipy_which_each_process_of_a_study_would_import() -> None:
    code = "import sys; from deploy.study.statistics import interval; interval([40, 50]); "
    code += "sys.exit('scipy.stats' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_an_interval_has_the_bits_of_scipy_s_own_quantile_and_standard_error() -> None:
    values = np.random.default_rng(1).normal(size=100)
    for n in range(2, 100):
        half = float(stats.t.ppf(0.975, n - 1) * stats.sem(values[:n]))
        assert statistics.interval(values[:n]).high == float(np.mean(values[:n])) + half


def test_five_numbers_are_the_quartiles_and_the_ends() -> None:
    assert statistics.five_numbers([5, 1, 3, 2, 4]) == [1, 2, 3, 4, 5]


def test_ratios_differ_significantly_from_1_with_pairing_and_not_without() -> None:
    hard = np.array([100, 300, 900, 2700, 8100.0])
    noise = np.array([1.01, 0.98, 1.0, 1.02, 0.99])
    test = statistics.ratio_within((0.8 * hard * noise).tolist(), hard.tolist(), 0, 1)
    assert test.effect.mean == pytest.approx(0.8, rel=0.01)
    assert test.effect.low < 0.8 < test.effect.high < 0.85
    assert test.p_for < 0.001 and test.p_against > 0.999 and test.d < -5
    logs = np.log(0.8 * noise)
    assert test.p_for == pytest.approx(float(stats.ttest_1samp(logs, 0, alternative="less").pvalue))


def test_equal_within_a_margin_needs_evidence_on_both_sides() -> None:
    base = [100.0] * 6
    near = [99.0, 101, 100, 102, 98, 100.5]
    assert statistics.ratio_within(near, base, 0.9, 1.1).p_for < 0.001
    few = statistics.ratio_within([80.0, 125, 100], base[:3], 0.9, 1.1)
    assert few.p_for > 0.05 and few.p_against > 0.05
    assert statistics.ratio_within([v * 1.5 for v in near], base, 0.9, 1.1).p_against < 0.001


def test_shares_are_tested_exactly() -> None:
    test = statistics.difference_within([1.0] * 8, [0.0] * 8, 0, INF)
    assert test.p_for == pytest.approx(0.5**8) and test.p_against == 1
    assert statistics.difference_within([1.0] * 5, [1.0] * 5, 0, INF).p_for == 1
    share = statistics.mean_within([1.0] * 20, 0.8, INF)
    assert share.p_for == pytest.approx(0.8**20) and share.effect.low == pytest.approx(0.8389, abs=1e-3)


def test_figures_without_any_spread_are_not_certain() -> None:
    assert statistics.mean_within([3.0] * 3, -INF, 4).p_for == 0.125
    assert statistics.mean_within([3.0], -INF, 4).p_for == 1


def test_trends_are_page_s() -> None:
    # Page 1963: three subjects, four treatments ranked alike, has the smallest p there is, (1 / 4!)^3.
    test = statistics.trend([[4, 3, 2, 1]] * 3, -1)
    assert test.effect.mean == pytest.approx(-1) and test.p_for == pytest.approx(24**-3)
    assert statistics.trend([[4, 3, 2, 1]] * 3, 1).p_for == pytest.approx(1)
    assert statistics.trend([[2, 2, 2]] * 3, 1).p_for == 1


def test_rank_correlation_is_kendall_s() -> None:
    assert statistics.same_order([1, 2, 3, 4, 5], [10, 20, 30, 40, 50]).p_for == pytest.approx(1 / 120)


def test_holm_s_example_by_hand() -> None:
    assert statistics.holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])


@given(st.lists(st.floats(0, 1), max_size=20))
def test_corrected_p_values_keep_their_order_and_are_no_smaller(p_values: list[float]) -> None:
    corrected = statistics.holm(p_values)
    assert all(p <= c <= 1 for p, c in zip(p_values, corrected, strict=True))
    order = np.argsort(p_values, kind="stable")
    assert (np.diff(np.array(corrected)[order]) >= 0).all()
