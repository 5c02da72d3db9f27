"""Measured values, and their ratios to a baseline."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from protocol.keyed_random import keyed_random

RESAMPLES = 2000

Result = TypeVar("Result")


@dataclass(frozen=True)
class Measurement:
    """One measured value."""

    name: str
    unit: str
    value: float
    """Median over repetitions."""
    baseline: str = ""
    """The quantity that it is compared with; empty without a comparison."""
    ratio: float | None = None
    """Median of value / baseline."""
    interval: tuple[float, float] | None = None
    """95 % bootstrap interval of the median ratio."""

    def line(self) -> str:
        """Format the measurement as one line of text."""
        text = f"{self.name:44} {self.value:12,.2f} {self.unit:10}"
        if self.ratio is not None:
            text += f" {self.ratio:6.2f} x {self.baseline}"
            if self.interval is not None:
                text += f" [{self.interval[0]:.2f}, {self.interval[1]:.2f}]"
        return text.rstrip()


def compare(
    name: str, unit: str, values: Sequence[float], baseline: str, against: Sequence[float]
) -> Measurement:
    """Compare paired repetitions with those of a baseline."""
    ratios = np.array(values, float) / np.array(against, float)
    draws = keyed_random(0, "bootstrap").integers(len(ratios), size=(RESAMPLES, len(ratios)))
    low, high = np.percentile(np.median(ratios[draws], axis=1), [2.5, 97.5]).tolist()
    return Measurement(name, unit, float(np.median(values)), baseline, float(np.median(ratios)), (low, high))


def timed(work: Callable[[], Result]) -> tuple[Result, float]:
    """Call a function; return its result and its processor time in milliseconds."""
    began = time.thread_time_ns()
    result = work()
    return result, (time.thread_time_ns() - began) / 1e6
