"""The layout of figures: wrap and turn text so that all of it fits, and choose the scale of an axis."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend
    from matplotlib.text import Text
    from matplotlib.transforms import Bbox

GAP: Final = 3.0
"""Minimum distance between labels of ticks, in pixels."""


def fit(canvas: Figure, panels: Sequence[Axes], legend: Callable[[int], Legend] | None, entries: int) -> None:
    """Make all text of a figure fit: wrap labels and titles, and turn or leave out labels of ticks.

    `legend` draws the figure's legend of `entries` entries with a number of columns.
    """
    columns = entries
    drawn = legend(columns) if legend else None
    _arrange(canvas)
    while legend and drawn and columns > 1 and drawn.get_window_extent().width > canvas.bbox.width:
        drawn.remove()
        columns -= 1
        drawn = legend(columns)
        _arrange(canvas)
    if drawn is not None:
        rows = math.ceil(entries / columns) + bool(drawn.get_title().get_text())
        line = 1.5 / 72 * drawn.get_texts()[0].get_fontproperties().get_size_in_points()
        canvas.set_figheight(canvas.get_figheight() + rows * line)
        _arrange(canvas)
    for panel in panels:
        _turn_ticks(canvas, panel)
    for panel in panels:
        box = panel.get_window_extent()
        _wrap(panel.yaxis.label, box.height, lambda extent: extent.height)
        for text in (panel.title, panel.xaxis.label):
            _wrap(text, box.width, lambda extent: extent.width)


def _arrange(canvas: Figure) -> None:
    """Compute the positions of all parts of a figure."""
    engine = canvas.get_layout_engine()
    assert engine is not None
    engine.execute(canvas)


def _turn_ticks(canvas: Figure, panel: Axes) -> None:
    """Turn the labels of a panel's x axis if they overlap; if they still do, show every second one, and so on."""
    if not _overlap(panel):
        return
    panel.tick_params(axis="x", labelrotation=90)
    _arrange(canvas)
    labels = [label.get_text() for label in panel.get_xticklabels()]
    for step in range(2, len(labels)):
        if not _overlap(panel):
            return
        panel.set_xticks(panel.get_xticks(), [text if n % step == 0 else "" for n, text in enumerate(labels)])
        _arrange(canvas)


def _overlap(panel: Axes) -> bool:
    boxes = [label.get_window_extent() for label in panel.get_xticklabels() if label.get_text()]
    return any(left.x1 + GAP > right.x0 for left, right in pairwise(sorted(boxes, key=lambda box: box.x0)))


def _wrap(text: Text, space: float, size: Callable[[Bbox], float]) -> None:
    """Break a text into lines of similar lengths if it is longer than `space` pixels."""
    words = text.get_text()
    if words and (length := size(text.get_window_extent())) > space:
        fitting, balanced = int(len(words) * space / length), len(words) / math.ceil(length / space)
        text.set_text(textwrap.fill(words, max(8, min(fitting, int(balanced) + 6)), break_long_words=False))


def spread(numbers: Sequence[float]) -> bool:
    """Whether numbers on an axis are so unevenly spaced that it should be logarithmic."""
    gaps = np.diff(numbers)
    return len(gaps) > 1 and min(numbers) > 0 and bool(gaps.max() >= 10 * gaps.min())
