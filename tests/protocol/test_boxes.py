"""Boxes of changes: a few boxes cover all changes."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from protocol.boxes import MAX_BOXES, NO_BOXES, Boxes, bounding_box, union, whole_grid
from protocol.scans import GridChange

SIDE = 60
corners = st.tuples(*[st.integers(-2, SIDE)] * 2, *[st.integers(1, 12)] * 2)


def covered(boxes: Boxes) -> NDArray[np.bool_]:
    cells = np.zeros((SIDE + 20, SIDE + 20), np.bool_)
    for x0, y0, x1, y1 in boxes.tolist():
        cells[y0 + 2 : y1 + 2, x0 + 2 : x1 + 2] = True
    return cells


@given(st.lists(st.lists(corners, max_size=9), max_size=6))
def test_the_union_covers_all_boxes_with_few(lots: list[list[tuple[int, int, int, int]]]) -> None:
    together, wanted = NO_BOXES, covered(NO_BOXES)
    for lot in lots:
        boxes = np.array([(x, y, x + w, y + h) for x, y, w, h in lot], np.int32).reshape(-1, 4)
        together, wanted = union(together, boxes), wanted | covered(boxes)
        assert len(together) <= MAX_BOXES
        assert (covered(together) | ~wanted).all()


def test_distant_boxes_stay_separate() -> None:
    one, other = np.array([(0, 0, 3, 3)], np.int32), np.array([(50, 50, 53, 53)], np.int32)
    assert union(one, other).tolist() == [[0, 0, 3, 3], [50, 50, 53, 53]]
    assert union(one, one + 2).tolist() == [[0, 0, 5, 5]]


def test_the_bounding_box_contains_all_boxes() -> None:
    assert bounding_box(np.array([(3, 0, 5, 2), (-1, 4, 4, 9)], np.int32)) == (-1, 0, 5, 9)


def test_a_change_without_cells_has_no_box() -> None:
    assert GridChange(0, (9, 9, 0, 0)).boxes.tolist() == []
    assert GridChange(2, (3, 4, 5, 6)).boxes.tolist() == [[3, 4, 5, 6]]
    assert whole_grid((4, 7)).tolist() == [[0, 0, 7, 4]]
