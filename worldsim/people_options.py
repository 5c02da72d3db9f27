"""Options of people who walk about in the simulated world."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from protocol.bounds import check_bounds
from protocol.message_fields import MAX_PEOPLE

MAX_WALKING_SPEED = 5.0

MIN_RADIUS_M, MAX_RADIUS_M = 0.05, 1.0


@dataclass(frozen=True)
class PeopleOptions:
    """People in the building.

    Attributes
    ----------
    number : int
        How many there are.
    speed : float
        Walking speed in meters per second; 0: they stand still. The default is the mean of pedestrians (Weidmann,
        *Transporttechnik der Fussgänger*, 1993).
    radius : float
        Radius of the disc that a person covers, in meters.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    number: int = 0
    speed: float = 1.34
    radius: float = 0.25

    def __post_init__(self) -> None:
        check_bounds(self, "number", 0, MAX_PEOPLE)
        check_bounds(self, "speed", 0, MAX_WALKING_SPEED, "m/s")
        check_bounds(self, "radius", MIN_RADIUS_M, MAX_RADIUS_M, "m")
