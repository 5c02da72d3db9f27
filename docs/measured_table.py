"""A table of a page that shows measurements: its cells, and how they are measured and replaced."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

DOCS = Path(__file__).parent

Row = dict[str, str]
"""The cells of a row by the heads of their columns."""
Value = Callable[[Row, str], str | None]
"""Measures the cell of a row and a column, as text; None if the cell is not measured."""

ALL_CELLS = ((-1, -1),)
"""`Figure.fast` of tables of which all cells take seconds."""


@dataclass(frozen=True)
class Figure:
    """A table of a page that shows measurements.

    Attributes
    ----------
    page : str
        The page, relative to ``docs``.
    head : str
        The beginning of the table's first line.
    value : callable
        Measures a cell.
    fast : tuple of (row, column)
        Cells that take seconds, by their numbers from 0; or `ALL_CELLS`.
    labels : int
        How many columns at the left describe the row; an empty cell in the first column repeats the one above.
    number : int
        Which of several tables with this head it is, from 0.
    """

    page: str
    head: str
    value: Value
    fast: tuple[tuple[int, int], ...] = ()
    labels: int = 1
    number: int = 0

    @property
    def columns(self) -> list[str]:
        """The heads of the columns."""
        return _cells(self._lines()[0])

    @property
    def rows(self) -> list[list[str]]:
        """The cells of the table, without its head."""
        return [_cells(line) for line in self._lines()[2:]]

    def places(self, *, fast: bool) -> Iterator[tuple[int, int]]:
        """Yield row and column of the measured cells."""
        if fast and self.fast != ALL_CELLS:
            yield from self.fast
            return
        for row in range(len(self.rows)):
            yield from ((row, column) for column in range(self.labels, len(self.columns)))

    def measure(self, row: int, column: int) -> str | None:
        """Measure a cell."""
        first = next((each[0] for each in self.rows[row::-1] if each[0]), "")
        cells = [first, *self.rows[row][1:]]
        return self.value(dict(zip(self.columns, cells, strict=True)), self.columns[column])

    def replace(self, row: int, column: int, text: str) -> None:
        """Replace a cell on the page."""
        lines = self._lines()
        cells = self.rows[row]
        cells[column] = text
        changed = "|" + "".join(f" {cell} |" if cell else " |" for cell in cells)
        page = DOCS / self.page
        content, table = page.read_text(encoding="utf-8"), "\n".join(lines)
        page.write_text(
            content.replace(table, "\n".join([*lines[: row + 2], changed, *lines[row + 3 :]])),
            encoding="utf-8",
        )

    def _lines(self) -> list[str]:
        """The lines of the table."""
        lines = (DOCS / self.page).read_text(encoding="utf-8").splitlines()
        starts = [number for number, line in enumerate(lines) if line.startswith(self.head)]
        if len(starts) <= self.number:
            raise ValueError(f"docs/{self.page}: there is no such table: {self.head}")
        table = lines[starts[self.number] :]
        return table[: next((n for n, line in enumerate(table) if not line.startswith("|")), len(table))]


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().strip("|").split("|")]
