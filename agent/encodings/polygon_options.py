"""What of the polygon exchange can be chosen, and which choices are the thesis' plain rules."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

MAX_USE = 100
"""So many times the medium may be planned with at most."""


@dataclass(frozen=True)
class PolygonOptions:
    """Options of the polygon exchange; `THESIS_OPTIONS` are the thesis' plain rules.

    Attributes
    ----------
    medium_use : float
        Part u of the medium that the splitting frequency plans with (Eq. 5.5); it stands for a customised p of
        Eq. 5.6 as well, since only their product counts.
    bytes_per_split : float
        Mean bytes d that a split causes; 0: measured as the run goes.
    splits_per_step : float
        Splits a step, s, for one robot and without a budget too; 0: by Eq. 5.5.
    lazy : bool
        Log an edit script only once the teammates in range hold the one before, so that what changes twice
        is sent once. Splits of the steps between lapse: s of Eq. 5.5 is then a number per logged script. And
        while nobody is in range, what is told, and with it Eq. 6.1, stays as it was.
    mixed_first : bool
        Refine edges of mixed occupancy before all others: they send teammates to walls that are known.
    free_inside_edges : bool
        Draw inside edges that are labelled free. They claim cells free which nobody has seen.
    unknown_pairs : bool
        Tell of and draw outside objects that are approximated by two vertices and no occupied edge: unseen
        specks between beams, and small things whose walls are not told.
    wide_walls : bool
        Take what is unknown beside the wall of a teammate in range for wall: coarse walls run beside the true
        ones.
    wide_seen_walls : bool
        Also beside a wall that the robot has seen itself. Without it no small opening is taken for wall, so maps are
        complete; specks in walls must be looked at, which takes some steps more. Scenarios with `repairmen` leave it
        out unless they say otherwise.
    close_slivers : bool
        Take unknown slivers between free cells that teammates have told of for free: there coarse areas meet.
    exact_error : bool
        Measure also what an exact approximation would get wrong, in each step: Eq. 6.1 less that is what is
        due to coarseness. It changes no result, and takes a third of a robot's time.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    medium_use: float = 1.0
    bytes_per_split: float = 0.0
    splits_per_step: float = 0.0
    lazy: bool = True
    mixed_first: bool = True
    free_inside_edges: bool = False
    unknown_pairs: bool = False
    wide_walls: bool = True
    wide_seen_walls: bool = True
    close_slivers: bool = True
    exact_error: bool = False

    def __post_init__(self) -> None:
        if not 0 < self.medium_use <= MAX_USE:
            raise ValueError(f"medium_use = {self.medium_use:g}: must be above 0 and at most {MAX_USE}")
        if self.bytes_per_split and not 1 <= self.bytes_per_split < math.inf:
            raise ValueError(
                f"bytes_per_split = {self.bytes_per_split:g}: must be 0 (measured), or 1 or more"
            )
        if not 0 <= self.splits_per_step < math.inf:
            raise ValueError(
                f"splits_per_step = {self.splits_per_step:g}: must be 0 (by the bandwidth), or more"
            )


THESIS_OPTIONS = PolygonOptions(
    medium_use=0.5,
    lazy=False,
    mixed_first=False,
    free_inside_edges=True,
    unknown_pairs=True,
    wide_walls=False,
    close_slivers=False,
)
