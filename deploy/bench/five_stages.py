"""Algorithm 9 line by line, in the stages of Figure 5.6: baseline and reference of `agent.outline.merge`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from agent.outline.claims import THESIS, Drawing
from agent.outline.polygons import SIDE_X, SIDE_Y, Polygons
from agent.outline.raster import draw, fill
from protocol.boxes import whole_grid
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid

UNDEFINED = 3
"""State, between the stages, of a cell that no approximation has determined yet."""


@dataclass(frozen=True, eq=False)
class Stages:
    """The planning grid after each stage of Figure 5.6."""

    outside_filled: Grid
    """(a) Outside objects are filled with unknown cells; all other cells are undefined."""
    outside_bounded: Grid
    """(b) Their boundaries are drawn; unknown cells do not replace occupied ones."""
    inside_filled: Grid
    """(c), (d) Within an inside object, cells become free that are undefined, or unknown and in no outside object of
    the same robot."""
    inside_bounded: Grid
    """(e) The boundaries of the inside objects are drawn; occupied cells replace free ones."""
    complete: Grid
    """(f) Undefined cells become unknown; the self-explored grid overrides all. With the options of `Drawing`, unknown
    cells beside an occupied boundary become occupied, and unknown slivers free."""


def five_stages(own: Grid, approximations: Sequence[Polygons], drawing: Drawing = THESIS) -> Stages:
    """Merge the approximations of teammates with the self-explored grid `own` by Algorithm 9."""
    plan = np.full(own.shape, UNDEFINED, np.uint8)
    objects = [_objects(polygons, drawing) for polygons in approximations]
    outside = [[each for each in team_object if not each.inside] for team_object in objects]
    inside = [[each for each in team_object if each.inside] for team_object in objects]

    for each in chain(*outside):
        plan[each.filled] = UNKNOWN
    outside_filled = plan.copy()

    for each in chain(*outside):
        plan[each.other_edges & (plan != OCCUPIED)] = UNKNOWN
        plan[each.occupied_edges] = OCCUPIED
    outside_bounded = plan.copy()

    for around, within in zip(inside, outside, strict=True):
        contained = np.zeros(own.shape, np.bool_)
        for each in within:
            contained |= each.filled | each.other_edges | each.occupied_edges
        for each in around:
            plan[each.filled & (plan == UNKNOWN) & ~contained] = FREE
            plan[each.filled & (plan == UNDEFINED)] = FREE
    inside_filled = plan.copy()

    if drawing.free_inside_edges:
        walls = np.zeros(own.shape, np.bool_)
        for each in chain(*outside) if drawing.keep_walls else ():
            walls |= each.occupied_edges
        for each in chain(*inside):
            plan[each.other_edges & ~walls] = FREE
    for each in chain(*inside):
        plan[each.occupied_edges] = OCCUPIED
    inside_bounded = plan.copy()

    plan[plan == UNDEFINED] = UNKNOWN
    if drawing.wide_walls:
        walls = np.zeros(own.shape, np.bool_)
        for each in chain(*outside, *inside):
            walls |= each.occupied_edges
        if not drawing.wide_seen_walls:
            walls &= own != OCCUPIED
        plan[binary_dilation(walls, np.ones((3, 3))) & (plan == UNKNOWN)] = OCCUPIED
    plan[own != UNKNOWN] = own[own != UNKNOWN]
    if drawing.close_slivers:
        free, seen = np.pad(plan == FREE, 1), np.pad(own != UNKNOWN, 1)
        beside, above = (np.s_[1:-1, :-2], np.s_[1:-1, 2:]), (np.s_[:-2, 1:-1], np.s_[2:, 1:-1])
        for one, other in (beside, above):
            plan[(plan == UNKNOWN) & free[one] & free[other] & ~(seen[one] & seen[other])] = FREE
    return Stages(outside_filled, outside_bounded, inside_filled, inside_bounded, plan)


@dataclass(frozen=True, eq=False)
class _Object:
    inside: bool
    filled: NDArray[np.bool_]
    occupied_edges: NDArray[np.bool_]
    other_edges: NDArray[np.bool_]


def _objects(polygons: Polygons, drawing: Drawing) -> list[_Object]:
    """Rasterize each object by itself."""
    objects = []
    side, occupied = polygons.side, polygons.occupied
    places = np.column_stack([4 * polygons.x + SIDE_X[side], 4 * polygons.y + SIDE_Y[side]])
    for inside, first, end in zip(polygons.inside, polygons.start[:-1], polygons.start[1:], strict=True):
        if not (inside or drawing.unknown_pairs or end - first > 2 or occupied[first:end].any()):
            continue
        area, edges = np.zeros(polygons.shape, np.uint8), np.zeros(polygons.shape, np.uint8)
        outline, everywhere = places[first:end], whole_grid(polygons.shape)[0]
        all_edges = np.column_stack([outline, np.roll(outline, -1, axis=0), occupied[first:end]]).astype(
            np.int32
        )
        fill(area, all_edges, 1, 0, everywhere)
        draw(edges, all_edges, 1, 2, 0, everywhere)
        objects.append(_Object(bool(inside), area == 1, edges & 1 > 0, edges & 2 > 0))
    return objects
