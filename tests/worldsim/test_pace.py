"""Pacing: steps are not faster than the limit, and do not catch up after a slow one."""

from __future__ import annotations

import time

import pytest

from worldsim.pace import Pace


def test_steps_are_not_faster_than_the_limit() -> None:
    pace = Pace(100.0)
    began = time.monotonic()
    for _ in range(11):
        pace.wait()
    assert time.monotonic() - began >= 10 / 100


def test_steps_do_not_catch_up_after_a_slow_one() -> None:
    pace = Pace(20.0)
    pace.wait()
    time.sleep(0.2)
    pace.wait()
    began = time.monotonic()
    pace.wait()
    assert time.monotonic() - began >= 0.04


@pytest.mark.parametrize("slow", [0.0, -1.0, 0.4, float("nan")])
def test_pace_too_slow_for_an_interrupt_is_rejected(slow: float) -> None:
    with pytest.raises(ValueError, match=r"must be 0.5 steps per second or more"):
        Pace(slow)
