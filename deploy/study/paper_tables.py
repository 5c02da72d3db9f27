"""Tables for papers: LaTeX (booktabs) and CSV, with a line per setting and a column per metric."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from deploy.study.figure_style import FigureStyle
from deploy.study.results import write_table
from worldsim.atomic_files import write_whole

if TYPE_CHECKING:
    import polars as pl
    from matplotlib.figure import Figure

Lines = Sequence[Sequence[str]]
"""A table as text; the first line is its header."""

NUMBER = re.compile(r"(<? ?-?[\d.,]+%?( (±|of) [\d.,]+)?( \[.*\])?( \(.*\))?|-|)")
"""Texts that are aligned to the right."""

SPECIAL = str.maketrans(
    {character: f"\\{character}" for character in "&%$#_{}"}
    | {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
    | {"<": "$<$", ">": "$>$", "±": r"$\pm$", "µ": r"$\mu$"}
)
"""LaTeX of characters that have a meaning of their own there."""


def latex(lines: Lines) -> str:
    """A table as a LaTeX tabular; its rules need the package booktabs."""
    head, *body = lines
    columns = [all(map(NUMBER.fullmatch, texts)) for texts in zip(*body, strict=True)]
    rows = [" & ".join(text.translate(SPECIAL) for text in line) + r" \\" for line in (head, *body)]
    kinds = "".join("r" if is_number else "l" for is_number in columns or [False] * len(head))
    return "\n".join(
        [rf"\begin{{tabular}}{{{kinds}}}", r"\toprule", rows[0], r"\midrule", *rows[1:], r"\bottomrule",
         r"\end{tabular}", ""]
    )  # fmt: skip


def write_tables(stem: Path, style: FigureStyle, lines: Lines, frame: pl.DataFrame | None = None) -> None:
    """Write a table as ``STEM-table.csv`` and ``STEM-table.tex``, if the style has these formats.

    The CSV file has the numbers of `frame`, by default the texts.
    """
    if "csv" in style.formats:
        text = frame.write_csv() if frame is not None else _csv(lines)
        write_whole(stem.with_name(f"{stem.name}-table.csv"), lambda out: out.write(text.encode()))
    if "tex" in style.formats:
        write_whole(stem.with_name(f"{stem.name}-table.tex"), lambda out: out.write(latex(lines).encode()))


def write_result(
    folder: Path, name: str, canvas: Figure, frame: pl.DataFrame, style: FigureStyle
) -> list[Path]:
    """Write ``NAME.png`` and ``NAME.csv``, and all formats of a style; return these two files."""
    files = [folder / f"{name}.png", folder / f"{name}.csv"]
    style.save(canvas, files[0])
    write_table(frame, files[1])
    write_tables(folder / name, style, texts(frame), frame)
    return files


def texts(frame: pl.DataFrame) -> list[list[str]]:
    """A table of numbers as text."""

    def text(value: object) -> str:
        return "-" if value is None else f"{value:.3g}" if isinstance(value, float) else str(value)

    return [frame.columns, *([text(value) for value in row] for row in frame.iter_rows())]


def _csv(lines: Lines) -> str:
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(lines)
    return out.getvalue()
