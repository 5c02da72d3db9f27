"""Options of people who walk about in the simulated world."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from protocol.bounds import Range, check_ranges
from protocol.message_fields import MAX_PEOPLE


@dataclass(frozen=True)
class PeopleOptions:
    """People in the building."""

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    number: Annotated[int, Range(0, MAX_PEOPLE)] = 0
    speed: Annotated[float, Range(0, 5.0, "m/s")] = 1.34
    """Walking speed in meters per second; 0: they stand still. The default is the mean of pedestrians (Weidmann,
    *Transporttechnik der Fussgänger*, 1993)."""
    radius: Annotated[float, Range(0.05, 1.0, "m")] = 0.25
    """Radius of the disc that a person covers, in meters."""

    def __post_init__(self) -> None:
        check_ranges(self)
