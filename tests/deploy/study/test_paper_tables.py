"""LaTeX and CSV files of tables."""

from __future__ import annotations

import csv
from pathlib import Path

import polars as pl

from deploy.study.figure_style import FigureStyle
from deploy.study.paper_tables import latex, texts, write_tables

LINES = [
    ["map", "n", "share of 5 % & more_or_less"],
    ["office", "3", "50 ± 25"],
    ["a~b", "2 of 3", "-"],
]


def test_a_latex_table_escapes_text_and_aligns_numbers() -> None:
    assert latex(LINES).splitlines() == [
        r"\begin{tabular}{lrr}",
        r"\toprule",
        r"map & n & share of 5 \% \& more\_or\_less \\",
        r"\midrule",
        r"office & 3 & 50 $\pm$ 25 \\",
        r"a\textasciitilde{}b & 2 of 3 & - \\",
        r"\bottomrule",
        r"\end{tabular}",
    ]


def test_a_table_without_lines_has_a_head() -> None:
    assert r"\begin{tabular}{lll}" in latex(LINES[:1])


def test_tables_are_written_in_the_chosen_formats(tmp_path: Path) -> None:
    frame = pl.DataFrame({"robots": [2, 3], "steps": [123.456, None]})
    write_tables(tmp_path / "a.b", FigureStyle(("tex", "csv", "pdf")), texts(frame), frame)
    write_tables(tmp_path / "texts", FigureStyle(("csv",)), LINES)
    write_tables(tmp_path / "none", FigureStyle(("pdf",)), LINES)
    assert sorted(file.name for file in tmp_path.iterdir()) == [
        "a.b-table.csv",
        "a.b-table.tex",
        "texts-table.csv",
    ]
    assert r"2 & 123 \\" in (tmp_path / "a.b-table.tex").read_text()
    assert (tmp_path / "a.b-table.csv").read_text() == "robots,steps\n2,123.456\n3,\n"
    assert list(csv.reader((tmp_path / "texts-table.csv").open())) == LINES
