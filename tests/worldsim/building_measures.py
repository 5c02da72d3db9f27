"""Measures of generated buildings.

Rooms and corridors are the morphological opening of the free space by a square wider than any door; doors are the
remainder.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import ndimage

from protocol.grid import FREE, UNKNOWN, Grid
from worldsim.maps import Map

SEEDS = range(12)
ALL_AROUND = np.ones((3, 3), bool)


def rooms_and_doors(world: Map, widest_door_m: float = 1.2) -> tuple[list[Any], list[Any]]:
    """Return the slices of all rooms and corridors, and the (short, long) sides of all doors in cells."""
    side = round(widest_door_m / world.resolution) // 2 * 2 + 1
    free = world.cells == FREE
    wide = ndimage.binary_opening(free, np.ones((side, side), bool))
    rooms = ndimage.find_objects(ndimage.label(wide)[0])
    gaps = ndimage.find_objects(ndimage.label(free & ~wide)[0])
    doors = [sorted((gap[0].stop - gap[0].start, gap[1].stop - gap[1].start)) for gap in gaps]
    return [(box, wide) for box in rooms], doors


def is_empty_rectangle(room: Any) -> bool:
    box, wide = room
    return bool(wide[box].all())


def area_m2(world: Map, room: Any) -> float:
    box, _ = room
    return float((box[0].stop - box[0].start) * (box[1].stop - box[1].start) * world.resolution**2)


def objects(cells: Grid) -> list[Any]:
    """Return (slices, area in cells) of all that is not free and does not touch the border."""
    labels, count = ndimage.label(np.pad(cells != FREE, 1, constant_values=True), ALL_AROUND)
    areas = np.bincount(labels.ravel(), minlength=count + 1)
    outside = labels[0, 0]
    boxes = ndimage.find_objects(labels)
    return [(boxes[label - 1], int(areas[label])) for label in range(1, count + 1) if label != outside]


def has_size(world: Map, width_m: float, height_m: float) -> bool:
    return (world.width, world.height) == (
        round(width_m / world.resolution),
        round(height_m / world.resolution),
    )


def check_enclosed_and_connected(world: Map) -> None:
    free = world.cells == FREE
    assert ndimage.label(free)[1] == 1
    assert not (ndimage.binary_dilation(free, ALL_AROUND) & (world.cells == UNKNOWN)).any()
    border = np.ones(free.shape, bool)
    border[1:-1, 1:-1] = False
    assert not (free & border).any()
    assert world.cells.flags.c_contiguous
