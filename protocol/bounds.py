"""Bounds of numeric options: a dataclass field has a `Range` in its annotation, and one check covers all fields."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, get_type_hints


@dataclass(frozen=True)
class Range:
    """Bounds of an option, both included: ``loss: Annotated[float, Range(0, 1)] = 0.0``."""

    least: float
    most: float
    unit: str = ""
    """Follows the bounds in the message, as "m/s"."""


class Options:
    """Base of dataclasses of options, the tables of scenarios; ValueError if a value is out of its `Range`."""

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    def __post_init__(self) -> None:
        check_ranges(self)


def check_ranges(options: Any) -> None:
    """Raise ValueError if a field of a dataclass is not a number within the `Range` of its annotation."""
    for name, bounds in _ranges(options.__class__).items():
        check_bounds(options, name, bounds.least, bounds.most, bounds.unit)


def check_bounds(options: object, name: str, least: float, most: float, unit: str = "") -> None:
    """Raise ValueError if the option with this name is not a number from `least` to `most`."""
    value = getattr(options, name)
    if not least <= value <= most:
        bounds = f"{_shown(least)} to {_shown(most)} {unit}".rstrip()
        raise ValueError(f"{name} = {_shown(value)}: must be {bounds}")


@cache
def _ranges(kind: type) -> dict[str, Range]:
    """Return the range of each field that has one, by name."""
    hints = get_type_hints(kind, include_extras=True)
    noted = {name: getattr(hint, "__metadata__", ()) for name, hint in hints.items()}
    return {name: each for name, notes in noted.items() for each in notes if isinstance(each, Range)}


def _shown(number: float) -> str:
    return str(number) if isinstance(number, int) else f"{number:g}"
