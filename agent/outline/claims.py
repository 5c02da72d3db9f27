"""The claims that an approximation makes of cells: its drawing, a byte of bits a cell.

Free area is what its inside object encloses and none of its outside objects encloses or bounds. What claim
counts where several meet, `agent.outline.merge` says.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.outline.boxes import Boxes, clip, whole
from agent.outline.polygons import Polygons
from agent.outline.raster import draw, fill
from protocol.kernels import kernel

BESIDE_WALL, FREE_AREA, OUTSIDE_OCCUPIED, INSIDE_FREE, INSIDE_OCCUPIED = 1, 2, 4, 8, 16
"""The claims of a layer; the stronger has the higher bit."""

Layer = NDArray[np.uint8]


@dataclass(frozen=True)
class Drawing:
    """What of an approximation is drawn. By default all of it, as in the thesis.

    Attributes
    ----------
    free_inside_edges : bool
        Draw inside edges that are labelled free. They claim cells free which their robot has not seen.
    unknown_pairs : bool
        Draw outside objects of two vertices and no occupied edge. They are the unseen specks between beams.
    wide_walls : bool
        Take the eight neighbours of a wall's cells for wall where nothing else is claimed of them.
    close_slivers : bool
        Take an unknown cell for free if its neighbours on the left and right or above and below are free, and
        not both by the robot's own sight.
    """

    free_inside_edges: bool = True
    unknown_pairs: bool = True
    wide_walls: bool = False
    close_slivers: bool = False


THESIS = Drawing()
"""All is drawn, as Algorithm 9 says."""


def layer(polygons: Polygons, drawing: Drawing = THESIS) -> Layer:
    """Render an approximation into the claims that it makes, a byte of bits a cell."""
    out = np.zeros(polygons.shape, np.uint8)
    draw_anew(out, polygons, drawing, np.zeros_like(out), whole(polygons.shape))
    return out


def draw_anew(out: Layer, polygons: Polygons, drawing: Drawing, scratch: Layer, boxes: Boxes) -> None:
    """Render the claims of an approximation in some boxes, in place of what was claimed there.

    `scratch` has the shape of the layer, and is zero before and after.
    """
    _render(
        out,
        polygons.x,
        polygons.y,
        polygons.side,
        polygons.occupied,
        polygons.start,
        polygons.inside,
        drawing.free_inside_edges,
        drawing.unknown_pairs,
        scratch,
        boxes,
    )


@kernel(
    "void(uint8[:,::1], int16[::1], int16[::1], uint8[::1], uint8[::1], int32[::1], boolean[::1], boolean, "
    "boolean, uint8[:,::1], int32[:,::1])"
)
def _render(
    out: NDArray[np.uint8],
    x: NDArray[np.int16],
    y: NDArray[np.int16],
    side: NDArray[np.uint8],
    occupied: NDArray[np.uint8],
    start: NDArray[np.int32],
    inside: NDArray[np.bool_],
    free_inside_edges: bool,
    unknown_pairs: bool,
    scratch: NDArray[np.uint8],
    boxes: Boxes,
) -> None:
    bounds = np.empty((len(inside), 4), np.int32)  # of each object, with a cell to spare
    for k in range(len(inside)):
        left, top, right, bottom = x[start[k]], y[start[k]], x[start[k]], y[start[k]]
        for i in range(start[k] + 1, start[k + 1]):
            left, right = min(left, x[i]), max(right, x[i])
            top, bottom = min(top, y[i]), max(bottom, y[i])
        bounds[k, 0], bounds[k, 1], bounds[k, 2], bounds[k, 3] = left - 1, top - 1, right + 2, bottom + 2
    box = np.empty(4, np.int32)
    other = INSIDE_FREE if free_inside_edges else 0
    for number in range(len(boxes)):
        clip(boxes[number], 0, out.shape, box)
        out[box[1] : box[3], box[0] : box[2]] = 0
        for k in range(len(inside)):
            if inside[k]:
                fill(out, x, y, side, start[k], start[k + 1], scratch, FREE_AREA, 0, box)
        for k in range(len(inside)):
            first, end = start[k], start[k + 1]
            if inside[k] or bounds[k, 0] >= box[2] or bounds[k, 2] <= box[0]:
                continue
            if bounds[k, 1] >= box[3] or bounds[k, 3] <= box[1]:
                continue
            if not unknown_pairs and end - first == 2 and not occupied[first] and not occupied[first + 1]:
                continue
            fill(out, x, y, side, first, end, scratch, 0, FREE_AREA, box)
            draw(out, x, y, side, occupied, first, end, OUTSIDE_OCCUPIED, 0, FREE_AREA, box)
        for k in range(len(inside)):
            if inside[k]:
                draw(out, x, y, side, occupied, start[k], start[k + 1], INSIDE_OCCUPIED, other, 0, box)
