"""Options of people who walk about in the simulated world."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from protocol.bounds import Options, Range
from protocol.message_fields import MAX_PEOPLE


@dataclass(frozen=True)
class PeopleOptions(Options):
    """People in the building."""

    number: Annotated[int, Range(0, MAX_PEOPLE)] = 0
    """Number of people who walk about in the building."""
    speed: Annotated[float, Range(0, 5.0, "m/s")] = 1.34
    """Walking speed, meters per step, which is a second by default; 0: they stand still. The default is the mean of
    pedestrians (Weidmann, *Transporttechnik der Fussgänger*, 1993)."""
    radius: Annotated[float, Range(0.05, 1.0, "m")] = 0.25
    """Radius of the disc that a person covers, meters."""
