"""Measured figures in docs are those that their commands give."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from docs.figures import FIGURES, NOT_CHECKED, differences
from docs.measured_table import DOCS, Figure
from docs.measurements import NotThere

MEASURED = ["peers.md", "predictive.md", "real-sensors.md", "recorded.md", "repairmen.md", "results"]
"""Pages and folders with measurements; `tests/deploy/test_docs.py` compares tables of other pages with the code."""

FROM_CODE = {
    "real-sensors.md | name |",
    "real-sensors.md | tolerance |",
    "real-sensors.md | setting |",
    "recorded.md | flag |",
}
"""Tables on these pages that describe the code."""


def name(figure: Figure) -> str:
    return f"{figure.page} {figure.head}"


FAST = [figure for figure in FIGURES if figure.fast]


@pytest.mark.parametrize("figure", FAST, ids=name)
def test_figures_that_take_seconds_are_those_of_their_commands(figure: Figure) -> None:
    assert list(differences(figure, fast=True)) == []


@pytest.mark.long
@pytest.mark.parametrize("figure", FIGURES, ids=name)
def test_figures_are_those_of_their_commands(figure: Figure) -> None:
    try:
        assert list(differences(figure, fast=False)) == []
    except NotThere as error:
        pytest.skip(str(error))


def test_each_table_of_measurements_is_checked_or_names_its_command() -> None:
    pages = [
        page
        for each in MEASURED
        for page in ([DOCS / each] if each.endswith(".md") else (DOCS / each).glob("*.md"))
    ]
    known = [*map(name, FIGURES), *NOT_CHECKED, *FROM_CODE]
    unknown = [
        place
        for page in pages
        for head, numbers in tables(page)
        if numbers > 1 and not (place := f"{page.relative_to(DOCS)} {head}").startswith(tuple(known))
    ]
    assert unknown == []


def tables(page: Path) -> list[tuple[str, int]]:
    """The first line of each table of a page, and how many of its cells are numbers."""
    found = []
    for table in re.findall(r"(?:^\|.*\n)+", page.read_text(encoding="utf-8"), re.M):
        head, _, *lines = table.splitlines()
        cells = [cell.strip() for line in lines for cell in line.strip("|").split("|")]
        found.append((head, sum(re.fullmatch(r"[\d.,]+( \S+)*", cell) is not None for cell in cells)))
    return found


def test_a_wrong_figure_is_named_and_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "page.md").write_text(
        "# Page\n\n| robots | steps |\n|---|---|\n| 1 | 12 |\n| 2 | 8 |\n\nEnd\n"
    )
    monkeypatch.setattr("docs.measured_table.DOCS", tmp_path)
    figure = Figure("page.md", "| robots |", lambda row, _: str(12 // int(row["robots"])))
    assert list(differences(figure, fast=False, write=True)) == [
        "docs/page.md: 2, steps: '8' on the page, measured '6'"
    ]
    assert "| 1 | 12 |\n| 2 | 6 |\n\nEnd" in (tmp_path / "page.md").read_text()
    assert list(differences(figure, fast=False)) == []
