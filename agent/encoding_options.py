"""Options of the encodings `polygons` and `predictive`, and the thesis' own choice."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

from protocol.bounds import Range, check_ranges

MAX_USE = 100
"""Largest `medium_use`."""
MAX_PATIENCE = 100
"""Largest `patience`."""
ValueFunction = Literal["segment-distance", "height", "width", "area"]
"""Value of an edge that stands for some contour points (`agent.outline.edge_value`).

``segment-distance``: the largest distance of a point to the edge (Algorithm 6). ``height``: that to the line through
the edge. ``width``: the width of the narrowest strip around these points and both vertices. ``area``: the square root
of the area between the edge and the contour, where parts on its two sides cancel out."""


@dataclass(frozen=True)
class PolygonOptions:
    """Options of the `polygons` encoding; `THESIS_OPTIONS` are the rules of the thesis."""

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    medium_use: float = 1.0
    """Share u of the medium that the splitting frequency plans with (Eq. 5.5). It also replaces the factor p of Eq.
    5.6, since only the product of the two counts."""
    bytes_per_split: float = 0.0
    """Mean bytes d that a split causes (Eq. 5.5); 0: measured during the run."""
    splits_per_step: float = 0.0
    """Splits s per step, also for a single robot and for an unlimited budget; 0: from Eq. 5.5."""
    lazy: bool = True
    """Log an edit script only when the teammates in range hold the script before, so that a vertex that changes twice
    is sent once. Splits of the steps between lapse: s of Eq. 5.5 then counts per logged script. While no teammate is in
    range, the logged approximation, and with it Eq. 6.1, does not change."""
    mixed_first: bool = True
    """Refine edges of mixed occupancy before all others: such edges draw teammates to walls that are known."""
    value_function: ValueFunction = "segment-distance"
    """Value of the edge that is refined first: ``segment-distance`` (Algorithm 6), ``height``, ``width``, or ``area``.
    The thesis names ``height`` and ``width``, too (4.3.1). ``area`` approximates what its Eq. 6.1 counts."""
    free_inside_edges: bool = False
    """Draw inside edges that are labeled free. They mark cells free that no robot has seen."""
    unknown_pairs: bool = False
    """Send and draw outside objects that are approximated by two vertices and no occupied edge: unseen specks between
    beams, and small obstacles whose walls are not sent."""
    wide_walls: bool = True
    """Treat unknown cells beside the wall of a teammate in range as wall: coarse walls run beside the true ones."""
    wide_seen_walls: bool = True
    """Treat unknown cells as wall also beside walls that the robot has seen itself; false by default with `repairmen`
    and other strategies that set `observes_from_distance`. Without it no small opening is taken for a wall, so maps are
    complete, but robots visit unknown specks in walls, which takes some steps more."""
    close_slivers: bool = True
    """Treat unknown slivers between free cells of teammates as free: coarse areas meet there."""
    keep_walls: bool = False
    """Let an occupied edge of an outside object override the free edge of another robot's inside object, where these
    meet. Algorithm 9 has the reverse. It matters only with `free_inside_edges`."""
    scan_order: bool = False
    """Send a `chg` packet also for each object whose place in scan order changes, as where objects are numbered anew in
    each step (Algorithm 3). Otherwise objects keep their numbers, and it costs nothing."""
    moving_starts: bool = False
    """Start the vertex list of each object where Algorithm 3 starts it: a start that moves costs `del` and `ins`
    packets. Otherwise lists start where packets are fewest."""
    exact_error: bool = False
    """Measure in each step also the error of an exact approximation (`approximation_error_net`). Eq. 6.1 minus this
    value is the error due to coarseness. It changes no result, and takes a third of a robot's time."""

    def __post_init__(self) -> None:
        if not 0 < self.medium_use <= MAX_USE:
            raise ValueError(f"medium_use = {self.medium_use:g}: must be above 0 and at most {MAX_USE}")
        if self.bytes_per_split and not 1 <= self.bytes_per_split < math.inf:
            raise ValueError(
                f"bytes_per_split = {self.bytes_per_split:g}: must be 0 (measured), or 1 or more"
            )
        if not 0 <= self.splits_per_step < math.inf:
            raise ValueError(
                f"splits_per_step = {self.splits_per_step:g}: must be 0 (from the bandwidth), or more"
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


@dataclass(frozen=True)
class PredictiveOptions:
    """Options of the `predictive` encoding."""

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    base: Literal["team", "own"] = "team"
    """Logs from which a robot predicts its scans: ``team``, its own and all that it has received; ``own``, its own.
    With ``own``, each log can be decoded alone, and takes up to three times the bytes."""
    patience: Annotated[int, Range(1, MAX_PATIENCE)] = 1
    """Factor of the times for which changed tiles of noisy maps wait; 2 by default in recorded runs. The larger, the
    later teammates receive changes, and the fewer bytes these take (`agent.predictive.tile_author`). In recorded runs,
    no robot plans with the maps of others."""

    def __post_init__(self) -> None:
        check_ranges(self)
