"""Round numbers along an axis."""

from __future__ import annotations

import math


def tick_values(first: float, last: float, most: int) -> list[float]:
    """Round numbers from `first` to `last`, approximately `most` of them at most."""
    rough = max((last - first) / most, 1e-9)
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * factor for factor in (1, 2, 5, 10) if power * factor >= rough * 0.999)
    return [step * k for k in range(math.ceil(first / step - 1e-9), math.floor(last / step + 1e-9) + 1)]
