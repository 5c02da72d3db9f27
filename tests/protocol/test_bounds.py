"""The check of options with bounds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Annotated

import pytest

from protocol.bounds import Range, check_bounds, check_ranges


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


@dataclass
class Base:
    loss: Annotated[float, Range(0, 1)] = 0.0


@dataclass
class Options(Base):
    name: str = ""
    speed: Annotated[float, Range(0.5, 5, "m/s")] = 1.0


def test_ranges_in_annotations_are_checked_also_those_of_base_classes() -> None:
    check_ranges(Options(1, "a", 5))
    with pytest.raises(ValueError, match=r"loss = 1.5: must be 0 to 1$"):
        check_ranges(Options(1.5))
    with pytest.raises(ValueError, match=r"speed = 0.25: must be 0.5 to 5 m/s"):
        check_ranges(Options(0, "a", 0.25))
