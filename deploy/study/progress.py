"""Progress of long work, with an estimate of the remaining time."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

INTERVAL_S = 60
"""Seconds between two lines of output without a terminal."""

Report = Callable[[int, int], object]
"""Called with the number of finished items and the total."""


@contextlib.contextmanager
def counting(console: Console, title: str) -> Iterator[Report]:
    """Show a progress bar with the remaining time; occasional lines if `console` is no terminal and no notebook."""
    if not (console.is_terminal or console.is_jupyter):
        yield _lines(console, title)
        return
    bar = Progress(
        TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(),
        TimeElapsedColumn(), TextColumn("left"),
        TimeRemainingColumn(elapsed_when_finished=False), console=console, transient=True,
    )  # fmt: skip
    task = bar.add_task(title, total=None)
    with bar:
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _lines(console: Console, title: str) -> Report:
    """Print a line every `INTERVAL_S`."""
    first: list[tuple[float, int]] = []
    printed = time.monotonic()

    def report(done: int, total: int) -> None:
        nonlocal printed
        now = time.monotonic()
        if not first:
            first.append((now, done))
        elif now - printed >= INTERVAL_S:
            began, before = first[0]
            printed = now
            minutes = (now - began) / (done - before) * (total - done) / 60
            left = f"{minutes:.0f} minutes" if minutes >= 1 else "less than a minute"
            console.print(f"{title}: {done} of {total}, {left} left")

    return report
