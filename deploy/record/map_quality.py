"""How well robots' maps fit the true map and each other: false cells, walls within one cell, agreement of walls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, maximum_filter

from deploy.scenario.plan import Plan
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid, Mask

Figures = dict[str, float | None]
"""Figures by name; None where there is nothing to compare."""

NOISE_CELLS = 4
"""Distance within which noisy lasers and poses displace cells of an honest map."""

FULL_SHARE = 0.999
"""Share of the reachable cells that a robot must know to know the full map."""

FALSE_SHARE = 0.1
"""Share of the known cells of an honest map of a noisy laser that may be false even so."""


def share_false(own: Grid, truth: Grid, *, noisy: bool) -> float:
    """Return the share of the known cells of a robot's own map that are false.

    Without noise, a cell is false if its state is not the true one. With noise, it is false if no cell within
    `NOISE_CELLS` has its state.
    """
    solid, known = truth != FREE, own != UNKNOWN
    if noisy:
        near_solid = _within(solid, NOISE_CELLS, beyond=True)
        near_free = _within(~solid, NOISE_CELLS)
    else:
        near_solid, near_free = solid, ~solid
    false = ((own == OCCUPIED) & ~near_solid) | ((own == FREE) & ~near_free)
    return float(false.sum() / max(known.sum(), 1))


def is_refuted(own: Grid, truth: Grid, reachable: Mask, seen: int, *, noisy: bool) -> bool:
    """Return whether an own map is false, or has more free cells than the `seen` ones of the whole team."""
    if noisy:
        return share_false(own, truth, noisy=True) > FALSE_SHARE
    return share_false(own, truth, noisy=False) > 0 or bool(((own == FREE) & reachable).sum() > seen)


def knows_all(planning: Grid, reachable: NDArray[np.intp]) -> bool:
    """Return whether at most a few of the reachable cells, given by their flat indices, are unknown (`FULL_SHARE`)."""
    return int(np.count_nonzero(planning.ravel()[reachable])) >= FULL_SHARE * len(reachable)


class WallScore(NamedTuple):
    """How well the walls of a map fit the true walls, within one cell; see `TrueWalls.score`."""

    precision: float | None
    recall: float | None
    f1: float | None


class TrueWalls:
    """The walls of the true map, which is `solid` beyond its border too, to compare walls of robots' maps with them.

    Beams end at the surfaces of walls: solid cells beside others.
    """

    def __init__(self, solid: Mask, reachable: Mask) -> None:
        self._near_surface = _within(solid & binary_dilation(~solid), 1, beyond=True)
        self._walls = solid & binary_dilation(reachable)
        """True walls that the team can see: those beside reachable cells."""

    def score(self, grid: Grid) -> WallScore:
        """Compare the walls of a map with the true walls.

        Precision is the share of its walls that have the surface of a true wall within one cell. Recall is the share
        of the true walls beside reachable cells that have one of its walls within one cell. F1 is their harmonic mean.
        A map without walls has no precision, and F1 of 0. Everything is None if the true map has no such walls.
        """
        if not self._walls.any():
            return WallScore(None, None, None)
        found = grid == OCCUPIED
        if not found.any():
            return WallScore(None, 0.0, 0.0)
        precision = float(self._near_surface[found].mean())
        recall = float(_within(found, 1)[self._walls].mean())
        both = precision + recall
        return WallScore(precision, recall, 2 * precision * recall / both if both else 0.0)


def true_walls_of(plan: Plan, reachable: Mask) -> TrueWalls:
    """Return the true walls of a run: all cells that are not free stop beams, but for those that no log shows."""
    cells = plan.map.cells
    return TrueWalls(cells == OCCUPIED if plan.recording is not None else cells != FREE, reachable)


def walls_held(
    walls: Mapping[int, Mask], shared: Mapping[int, Grid], tolerance: int
) -> dict[int, dict[int, float]]:
    """Return for each holder the share of each teammate's walls that it holds, by author.

    `walls` are the settled walls of the authors' own maps, `shared` the shared maps as their holders have them. A wall
    is held if that map has a wall within `tolerance` cells (Chebyshev). Authors without walls are left out.
    """
    places = {author: np.flatnonzero(mask) for author, mask in walls.items() if mask.any()}
    held: dict[int, dict[int, float]] = {}
    for holder, grid in shared.items():
        near = _within(grid == OCCUPIED, tolerance).ravel()
        held[holder] = {
            author: float(near[cells].mean()) for author, cells in places.items() if author != holder
        }
    return held


WALL_FIGURES = (
    "wall_precision", "wall_recall", "wall_f1", "walls_within_tolerance", "worst_walls_within_tolerance",
)  # fmt: skip
"""Figures of a robot that `robot_figures` returns."""


def robot_figures(
    planning: Mapping[int, Grid],
    shared: Mapping[int, Grid],
    walls: Mapping[int, Mask],
    true_walls: TrueWalls,
    tolerance: int,
) -> dict[int, Figures]:
    """Return the figures of each robot with a planning and a shared grid.

    They are those of `TrueWalls.score` of the planning grid, and the shares of teammates' settled `walls` that the
    shared grid has (`walls_held`): the mean over teammates, and the worst. These are None without teammates.
    """
    held = walls_held(walls, shared, tolerance)
    figures: dict[int, Figures] = {}
    for robot, grid in planning.items():
        score, shares = true_walls.score(grid), list(held[robot].values())
        values = score.precision, score.recall, score.f1, _mean(shares), min(shares, default=None)
        figures[robot] = dict(zip(WALL_FIGURES, values, strict=True))
    return figures


def team_figures(figures: Mapping[int, Figures], first: int) -> Figures:
    """Return the figures of a team: those of the first robot, the mean, and the worst robot.

    The share of teammates' walls has no first robot: it concerns pairs.
    """
    team: Figures = {}
    for name in ("wall_precision", "wall_recall", "wall_f1"):
        known = {robot: value for robot, each in figures.items() if (value := each[name]) is not None}
        team |= first_mean_worst("claimed_", name, known, first)
    team["walls_within_tolerance"] = _mean(_known(figures, "walls_within_tolerance"))
    team["worst_walls_within_tolerance"] = min(_known(figures, "worst_walls_within_tolerance"), default=None)
    return team


def first_mean_worst(prefix: str, name: str, values: Mapping[int, float], first: int) -> Figures:
    """Return a figure of each robot as those of a team: of the first robot, the mean, and the worst robot's."""
    shares = list(values.values())
    return {
        f"{prefix}{name}": values.get(first),
        f"{prefix}mean_{name}": _mean(shares),
        f"{prefix}worst_{name}": min(shares, default=None),
    }


def _within(mask: Mask, cells: int, *, beyond: bool = False) -> Mask:
    """Return the cells within a distance (Chebyshev) of a mask's cells; `beyond`: whether cells outside belong to it.

    On large grids this filter is several times as fast as `binary_dilation`.
    """
    near: Mask = maximum_filter(mask, 2 * cells + 1, mode="constant", cval=beyond)
    return near


def _known(figures: Mapping[int, Figures], name: str) -> list[float]:
    """Return the values of a figure, of the robots that have one."""
    return [value for robot in figures.values() if (value := robot[name]) is not None]


def _mean(values: Sequence[float]) -> float | None:
    return fmean(values) if values else None
