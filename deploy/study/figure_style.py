"""The style of figures and tables for papers: size, fonts, and file formats."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from worldsim.atomic_files import write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
DPI: Final = 90


@dataclass(frozen=True)
class FigureStyle:
    """How figures and tables are written."""

    formats: tuple[str, ...] = ()
    """Formats of `FORMATS` that are written besides the default ones."""
    figure_width: float | None = None
    """Width of each figure; by default `PANEL` for each panel."""
    font: str | None = None
    """Font family, as ``serif`` or ``Times New Roman``."""
    font_size: float = FONT_SIZE
    """In points."""

    def __post_init__(self) -> None:
        for name in self.formats:
            if name not in FORMATS:
                raise ValueError(f"formats = {name!r}: must be some of {', '.join(FORMATS)}")
        for key, value, high in (("figure_width", self.figure_width, 100), ("font_size", self.font_size, 40)):
            if value is not None and not 4 <= value <= high:
                raise ValueError(f"{key} = {value:g}: must be from 4 to {high}")
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


def _check_font(font: str) -> None:
    from matplotlib import font_manager  # noqa: PLC0415  half a second to import

    try:
        font_manager.findfont(font, fallback_to_default=False)
    except ValueError:
        generic = "serif, sans-serif, monospace"
        raise ValueError(f"font = {font!r}: is not installed; use {generic} or the name of a font") from None
