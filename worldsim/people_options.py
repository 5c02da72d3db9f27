"""Options of people who walk about in the simulated world."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from protocol.messages import MAX_PEOPLE

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
        if not 0 <= self.number <= MAX_PEOPLE:
            raise ValueError(f"number = {self.number}: must be 0 to {MAX_PEOPLE}")
        if not 0 <= self.speed <= MAX_WALKING_SPEED:
            raise ValueError(f"speed = {self.speed:g}: must be 0 to {MAX_WALKING_SPEED:g} m/s")
        if not MIN_RADIUS_M <= self.radius <= MAX_RADIUS_M:
            raise ValueError(f"radius = {self.radius:g}: must be {MIN_RADIUS_M:g} to {MAX_RADIUS_M:g} m")
