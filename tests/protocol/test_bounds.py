"""The check of options with bounds."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from protocol.bounds import check_bounds


@pytest.mark.parametrize("value", [0.5, 1, 2_000_000])
def test_numbers_within_the_bounds_pass(value: float) -> None:
    check_bounds(SimpleNamespace(size=value), "size", 0.5, 2_000_000)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (0.25, "size = 0.25: must be 0.5 to 2000000 m"),
        (2_000_001, "size = 2000001: must be 0.5 to 2000000 m"),
        (math.nan, "size = nan: must be 0.5 to 2000000 m"),
        (1e300, "size = 1e+300: must be 0.5 to 2000000 m"),
    ],
)
def test_other_numbers_are_named_with_the_bounds(value: float, message: str) -> None:
    with pytest.raises(ValueError) as raised:
        check_bounds(SimpleNamespace(size=value), "size", 0.5, 2_000_000, "m")
    assert str(raised.value) == message
