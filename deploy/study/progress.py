"""Progress of long work, with an estimate of the remaining time."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn, TimeRemainingColumn

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
    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), "left", TimeRemainingColumn())
    with Progress("{task.description}", *columns, console=console, transient=True) as bar:
        task = bar.add_task(title, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _lines(console: Console, title: str) -> Report:
    """Print a line every `INTERVAL_S`."""
    began = printed = time.monotonic()
    before: int | None = None

    def report(done: int, total: int) -> None:
        nonlocal printed, before
        now = time.monotonic()
        before = done if before is None else before
        if now - printed >= INTERVAL_S and done > before:
            printed = now
            minutes = (now - began) / (done - before) * (total - done) / 60
            left = f"{minutes:.0f} minutes" if minutes >= 1 else "less than a minute"
            console.print(f"{title}: {done} of {total}, {left} left")

    return report
