"""Checks of figures that matplotlib can make: all data within the axes, all text readable, units on the axes."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain, combinations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.path import Path
from matplotlib.text import Text
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

PIXEL = 1.0


def _lay_out(figure: Figure) -> None:
    """Draw a figure, unless it has not changed since it was drawn."""
    if figure.stale:
        figure.draw_without_rendering()


def paths(axes: Axes) -> Iterator[NDArray[np.float64]]:
    """The vertices of all lines, bars, boxes, areas and intervals of some axes, in pixels."""
    for line in axes.lines:
        yield line.get_transform().transform_path(line.get_path()).vertices
    for patch in axes.patches:
        yield _vertices(patch.get_transform().transform_path(patch.get_path()))
    for collection in axes.collections:
        for path in collection.get_paths():
            yield _vertices(collection.get_transform().transform_path(path))


def _vertices(path: Path) -> NDArray[np.float64]:
    return path.vertices if path.codes is None else path.vertices[path.codes != Path.CLOSEPOLY]


def assert_shows_all(figure: Figure) -> None:
    """Fail if a point of a line, bar, box, area or interval is outside its axes."""
    _lay_out(figure)
    for axes in figure.axes:
        box = axes.bbox
        for vertices in paths(axes):
            shown = vertices[np.isfinite(vertices).all(axis=1)]
            low, high = shown.min(axis=0, initial=np.inf), shown.max(axis=0, initial=-np.inf)
            assert (low >= box.min - PIXEL).all() and (high <= box.max + PIXEL).all(), (
                axes.get_title(),
                low,
                high,
            )


def shown_texts(figure: Figure) -> list[Text]:
    """The texts that a figure shows; labels of ticks outside an axis, and axes and axis that are off, are not drawn."""
    hidden: set[Text] = set()
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            if not (axes.axison and axis.get_visible()):
                hidden |= set(axis.findobj(Text))
            hidden |= set(_outside(axis))
    texts = (text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip())
    return [text for text in texts if text not in hidden]


def _outside(axis: Axis) -> Iterator[Text]:
    """The labels of ticks that are not within the limits of an axis."""
    low, high = sorted(axis.get_transform().transform(axis.get_view_interval()))
    slack = 1e-6 * (high - low)
    for tick in chain(axis.get_major_ticks(), axis.get_minor_ticks()):
        if not low - slack <= axis.get_transform().transform(tick.get_loc()) <= high + slack:
            yield from (tick.label1, tick.label2)


def assert_text_fits(figure: Figure) -> None:
    """Fail if a text is cut at the border of a figure, or two texts overlap."""
    _lay_out(figure)
    boxes = [(text.get_text(), text.get_window_extent()) for text in shown_texts(figure)]
    assert boxes
    for text, box in boxes:
        assert (box.min >= -PIXEL).all() and (box.max <= figure.bbox.max + PIXEL).all(), (
            f"{text!r} is cut: {box}"
        )
    for (one, a), (other, b) in combinations(boxes, 2):
        common = Bbox.intersection(a, b)
        assert common is None or min(common.size) <= PIXEL, f"{one!r} overlaps {other!r}"


UNITLESS = ("strategy", "variant", "map", "map encoding", "")


def assert_has_units(figure: Figure) -> None:
    """Fail if the label of a numeric axis neither names a unit nor says that it is a number."""
    for axes in (each for each in figure.axes if each.axison):
        for axis in (axes.xaxis, axes.yaxis):
            text = " ".join(axis.get_label_text().split())
            if not any(label.get_visible() for label in axis.get_ticklabels()):
                continue
            assert "(" in text or text.startswith("number of") or text in UNITLESS, text
