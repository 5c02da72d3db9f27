"""The style of figures and tables for papers: size, fonts, and file formats."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from worldsim.atomic_files import write_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend
    from matplotlib.text import Text
    from matplotlib.transforms import Bbox

FIGURE_FORMATS: Final = ("pdf", "svg")
"""Formats of figures besides PNG, which is always written."""
TABLE_FORMATS: Final = ("csv", "tex")
"""Formats of tables with a line per setting and a column per metric."""
FORMATS: Final = (*FIGURE_FORMATS, *TABLE_FORMATS)

FONT_SIZE: Final = 10.0
"""Default size of all text, in points."""
CM_PER_INCH: Final = 2.54
COLUMNS: Final = 3
"""Maximum number of panels beside each other."""
PANEL: Final = 4.2, 3.2
"""Width and height of a panel in inches, if the figure's width is not given."""
MIN_PANEL: Final = 18
"""Minimum width of a panel, relative to the font size."""
GAP: Final = 3.0
"""Minimum distance between labels of ticks, in pixels."""
DPI: Final = 90


@dataclass(frozen=True)
class FigureStyle:
    """How figures and tables are written.

    Attributes
    ----------
    formats : tuple of str
        Formats of `FORMATS` that are written besides the default ones.
    figure_width : float, optional
        Width of each figure; by default `PANEL` for each panel.
    font : str, optional
        Font family, as ``serif`` or ``Times New Roman``.
    font_size : float
        Size of all text in points.
    """

    formats: tuple[str, ...] = ()
    figure_width: float | None = None
    font: str | None = None
    font_size: float = FONT_SIZE

    def __post_init__(self) -> None:
        for name in self.formats:
            if name not in FORMATS:
                raise ValueError(f"formats = {name!r}: must be some of {', '.join(FORMATS)}")
        for key in ("figure_width", "font_size"):
            value = getattr(self, key)
            low, high = {"figure_width": (4, 100), "font_size": (4, 40)}[key]
            if value is not None and not low <= value <= high:
                raise ValueError(f"{key} = {value:g}: must be from {low} to {high}")
        if self.font is not None:
            _check_font(self.font)

    @contextmanager
    def applied(self) -> Iterator[None]:
        """Draw or write figures in this style within the context."""
        import matplotlib  # noqa: PLC0415  half a second to import

        settings: dict[str, Any] = {
            "font.size": self.font_size, "axes.titlesize": "medium", "legend.title_fontsize": "medium",
            "pdf.fonttype": 42, "svg.hashsalt": "murmur",
        }  # fmt: skip
        with matplotlib.rc_context(settings | ({"font.family": self.font} if self.font else {})):
            yield

    def layout(self, panels: int) -> tuple[int, tuple[float, float]]:
        """The number of panels beside each other, and the width and height of a panel in inches."""
        if self.figure_width is None:
            return max(1, min(COLUMNS, panels)), PANEL
        width = self.figure_width / CM_PER_INCH
        columns = max(1, min(COLUMNS, panels, int(72 * width / (MIN_PANEL * self.font_size))))
        return columns, (width / columns, PANEL[1] / PANEL[0] * width / columns)

    def save(self, canvas: Figure, file: Path) -> None:
        """Write a figure in the format of the file's suffix, and beside it in the style's formats."""
        for ending in dict.fromkeys((file.suffix[1:], *self.formats)):
            if ending not in TABLE_FORMATS:
                write_whole(file.with_suffix(f".{ending}"), partial(self.write, canvas, ending))

    def write(self, canvas: Figure, ending: str, out: Any) -> None:
        """Write a figure to an open file, without variable metadata: equal figures have equal files."""
        variable = {"png": "Software", "pdf": "CreationDate", "svg": "Date"}[ending]
        with self.applied():
            canvas.savefig(out, format=ending, dpi=DPI, metadata={variable: None})


DEFAULT: Final = FigureStyle()


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


def _check_font(font: str) -> None:
    from matplotlib import font_manager  # noqa: PLC0415  half a second to import

    known = {entry.name for entry in font_manager.fontManager.ttflist}
    generic = ("serif", "sans-serif", "monospace")
    if font not in known and font not in generic:
        raise ValueError(f"font = {font!r}: is not installed; use {', '.join(generic)} or the name of a font")


def spread(numbers: Sequence[float]) -> bool:
    """Whether numbers on an axis are so unevenly spaced that it should be logarithmic."""
    gaps = np.diff(numbers)
    return len(gaps) > 1 and min(numbers) > 0 and bool(gaps.max() >= 10 * gaps.min())
