"""Splitting frequency: Eqs. 5.5 and 5.6 by numbers worked out by hand, and whole splits from fractions."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.outline.splitting import START_BYTES, START_SPLITS, SplitAllowance


def test_the_frequency_is_that_of_equation_5_5() -> None:
    team = SplitAllowance(
        robots=3, bandwidth=1000, reach=10, width=40, height=25, medium_use=0.6, bytes_per_split=12
    )
    in_range = 10 / 40 * 10 / 25 * 3
    assert team.frequency == pytest.approx(1000 * in_range * 0.6 / (6 * 12))


def test_robots_that_are_always_in_range_communicate_with_probability_1() -> None:
    for reach in (math.inf, 20):
        team = SplitAllowance(robots=8, bandwidth=1000, reach=reach, width=30, height=30, bytes_per_split=10)
        assert team.frequency == pytest.approx(1000 * 0.5 / (8 * 7 * 10))


@pytest.mark.parametrize(("robots", "bandwidth"), [(1, 1000.0), (4, None)])
def test_unlimited_refinement_continues_until_exact(robots: int, bandwidth: float | None) -> None:
    assert SplitAllowance(robots, bandwidth, 10, 30, 30).next_step() is None


@pytest.mark.parametrize(("robots", "bandwidth"), [(1, 1000.0), (4, None), (4, 0.0)])
def test_a_fixed_frequency_does_not_depend_on_the_bandwidth(robots: int, bandwidth: float | None) -> None:
    allowance = SplitAllowance(robots, bandwidth, 10, 30, 30, fixed=0.25)
    assert [allowance.next_step() for _ in range(8)] == [0, 0, 0, 1, 0, 0, 0, 1]


@given(st.integers(2, 64), st.floats(1, 1e5), st.floats(0.1, 1e3), st.floats(0.01, 1), st.integers(1, 200))
def test_fractions_of_splits_are_carried_over(
    robots: int, bandwidth: float, reach: float, medium_use: float, steps: int
) -> None:
    allowance = SplitAllowance(robots, bandwidth, reach, 30, 20, medium_use, bytes_per_split=15)
    frequency = allowance.frequency
    assert frequency is not None
    total = 0
    for step in range(1, steps + 1):
        splits = allowance.next_step()
        assert splits is not None
        total += splits
        assert total == pytest.approx(frequency * step, abs=1, rel=1e-9)


@pytest.mark.parametrize(("bandwidth", "reach"), [(0, 10), (1000, 0)])
def test_robots_without_bandwidth_or_range_refine_nothing(bandwidth: float, reach: float) -> None:
    allowance = SplitAllowance(3, bandwidth, reach, 30, 30)
    assert [allowance.next_step() for _ in range(50)] == [0] * 50


def test_bytes_per_split_are_measured_unless_they_are_given() -> None:
    allowance = SplitAllowance(3, 1000, 10, 30, 30)
    assert allowance.bytes_per_split == START_BYTES
    for _ in range(1000):
        allowance.spent(2, 60)
    expected = (START_SPLITS * START_BYTES + 60_000) / (START_SPLITS + 2000)
    assert allowance.bytes_per_split == pytest.approx(expected)
    assert SplitAllowance(3, 1000, 10, 30, 30, bytes_per_split=20).bytes_per_split == 20
