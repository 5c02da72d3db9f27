"""Measured figures in docs: which function measures each table, and whether it still gives what the page shows.

``python -m docs.figures`` checks all tables, which takes hours. ``--fast`` checks the cells that take seconds,
``--write`` replaces cells that differ, and names of pages choose tables. Runs of sweeps are kept in ``build/figures``,
so the same command continues after an interruption. `tests/deploy/test_figures.py` checks the fast cells, and with
``-m long`` all of them.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator

from docs import measurements
from docs.measured_table import ALL_CELLS, Figure
from docs.measurements import NotThere

FIGURES = (
    Figure("lesson-45.md", "| bandwidth |", measurements.lesson, fast=((3, 1),)),
    Figure("lesson.md", "| bandwidth |", measurements.exercise),
    Figure("results/radios.md", "| radio, robots |", measurements.losses, fast=((0, 1),)),
    Figure("results/radios.md", "| dissemination |", measurements.late_frames, fast=((1, 1),)),
    Figure("real-sensors.md", "| encoding | F1", measurements.map_quality),
    Figure("real-sensors.md", "| encoding | bytes |", measurements.baselines),
    Figure("predictive.md", "| lasers | tolerance |", measurements.tolerances, fast=((0, 3),), labels=2),
    Figure("recorded.md", "| log | robots |", measurements.recorded, labels=3),
    Figure("results/encodings.md", "| bytes per step |", measurements.rates),
    Figure("results/encodings.md", "| rules |", measurements.options),
    Figure("results/encodings.md", "| map | 3 robots |", measurements.kilobyte),
    Figure("results/predictive.md", "| robots | scans, unlimited |", measurements.against_scans),
    Figure("results/predictive.md", "| map | robots |", measurements.against_others, labels=2),
    Figure("results/predictive.md", "| robots | 10 % |", measurements.short_ranges),
    Figure("results/predictive.md", "| strategy | office, 3 |", measurements.narrow),
    Figure("results/reliability.md", "| encoding | `backoff` |", measurements.recovery),
    Figure("results/reliability.md", "| encoding | bytes per step |", measurements.forwarding, labels=2),
    *(
        Figure(
            "results/repairmen.md",
            "| strategy | scans, 3 robots |",
            measurements.rivals(stem),
            ALL_CELLS,
            number=number,
        )
        for number, stem in enumerate(("test-", "", "large-"))
    ),
    Figure("results/kinds.md", "| map | runs |", measurements.kinds, ALL_CELLS),
    Figure("peers.md", "| variant | longest path", measurements.peers("dars", "longest_path_95"), ALL_CELLS),
    Figure(
        "peers.md", "| robots | strategy |", measurements.peers("explore-bench", "t99"), ALL_CELLS, labels=2
    ),
    Figure("peers.md", "| strategy | steps to 90 %", measurements.peers("maes", "t90"), ALL_CELLS),
    Figure("peers.md", "| strategy | steps to 95 %", measurements.peers("mresim", "t95"), ALL_CELLS),
    Figure("repairmen.md", "| 100 B, 100 % |", measurements.short_range, labels=0),
    Figure(
        "results/paper-figures.md",
        "| figure | command | steps |",
        measurements.shipped_scenario,
        ALL_CELLS,
        labels=2,
    ),
)
"""The tables of measurements that are checked."""

NOT_CHECKED = {
    "peers.md | peer |": "means over the rows of the tables below it",
    "peers.md | rule |": "rules that the cited sources state",
    "real-sensors.md | encoding | office | intel |": "murmur sweep real-baselines.toml --out real-baselines.parquet",
    "real-sensors.md | sensors | map |": "murmur sweep real-sensors.toml: the page describes which runs it shows",
    "results/performance.md | robots | polygons": "murmur bench scale: times depend on the machine",
    "results/performance.md | robots | 2 |": "murmur bench scale: memory depends on the machine",
    "results/performance.md | encoding | steps/s |": "murmur bench swarm: times depend on the machine",
    "results/performance.md | cost |": "the commands in the table: times depend on the machine",
    "results/repairmen.md | | six buildings |": "means over the rows of the files that the page names",
    "results/kinds.md | | `burgard-optimal` |": "the command above the table: 180 runs",
    "results/predictive.md | | intel |": "the two commands of the page's first table: 400 runs",
    "results/predictive.md | `office` | `mixed` |": "the three commands above the table: 200 runs",
    "results/predictive.md | encoding, frontiers |": "its two commands, also with the setting: 240 runs",
    "results/predictive.md | map | 50 B |": "the two commands above the table: 360 runs",
    "results/strategies.md | strategy | steps |": "murmur bench strategies: times depend on the machine",
    "results/strategies.md | size |": "the two commands above the tables: 240 runs",
    "results/strategies.md | experiment |": "the commands in the table: 1200 runs",
    "results/full-size.md": "murmur reproduce writes the page, in days",
    "results/reproduction.md": "murmur reproduce --quick writes the page",
}
"""Other tables of measurements, by page and head, with the command that prints them, and why it is not repeated."""


def differences(figure: Figure, *, fast: bool, write: bool = False) -> Iterator[str]:
    """Yield a line for each cell of a table that differs from its measurement; with `write`, replace it."""
    for row, column in figure.places(fast=fast):
        found, shown = figure.measure(row, column), figure.rows[row][column]
        if found is not None and found != shown:
            place = f"{figure.rows[row][0] or '-'}, {figure.columns[column]}"
            yield f"docs/{figure.page}: {place}: {shown!r} on the page, measured {found!r}"
            if write:
                figure.replace(row, column, found)


def main(words: list[str]) -> int:
    """Print the differences; return 1 if there are any."""
    parser = argparse.ArgumentParser(
        prog="python -m docs.figures", description="Check measured figures in docs."
    )
    parser.add_argument("pages", nargs="*", help="as results/radios.md (default: all)")
    parser.add_argument("--fast", action="store_true", help="only cells that take seconds")
    parser.add_argument("--write", action="store_true", help="replace cells that differ")
    given = parser.parse_args(words)
    code = 0
    for figure in FIGURES:
        if given.pages and figure.page not in given.pages:
            continue
        print(f"docs/{figure.page}: {figure.head}", flush=True)
        try:
            for line in differences(figure, fast=given.fast, write=given.write):
                print(f"  {line}", flush=True)
                code = 1
        except NotThere as error:
            print(f"  not checked: {error}", flush=True)
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
