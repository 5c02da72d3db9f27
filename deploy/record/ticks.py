"""Round numbers along an axis."""

from __future__ import annotations

import math


def round_number(least: float) -> float:
    """Return 1, 2, or 5 times a power of ten: the smallest that is at least `least`."""
    power = 10.0 ** math.floor(math.log10(least))
    return next(power * factor for factor in (1, 2, 5, 10) if power * factor >= least)


def tick_values(first: float, last: float, most: float) -> list[float]:
    """Round numbers from `first` to `last`, approximately `most` of them at most."""
    step = round_number(0.999 * max((last - first) / most, 1e-9))
    return [step * k for k in range(math.ceil(first / step - 1e-9), math.floor(last / step + 1e-9) + 1)]
