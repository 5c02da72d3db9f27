"""The pace: steps come no faster than asked for, and what was late is not made up for."""

from __future__ import annotations

import time

import pytest

from worldsim.pace import Pace


def test_steps_come_no_faster_than_asked_for() -> None:
    pace = Pace(100.0)
    began = time.monotonic()
    for _ in range(11):
        pace.wait()
    assert time.monotonic() - began >= 10 / 100


def test_what_was_late_is_not_made_up_for() -> None:
    pace = Pace(20.0)
    pace.wait()
    time.sleep(0.2)
    pace.wait()
    began = time.monotonic()
    pace.wait()
    assert time.monotonic() - began >= 0.04


@pytest.mark.parametrize("slow", [0.0, -1.0, 0.4, float("nan")])
def test_a_pace_at_which_nobody_could_interrupt_is_refused(slow: float) -> None:
    with pytest.raises(ValueError, match=r"must be 0.5 steps per second or more"):
        Pace(slow)
