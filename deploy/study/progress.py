"""Progress of long work, with an estimate of the remaining time."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn, TimeRemainingColumn

INTERVAL_S = 60
"""Seconds between two lines of output without a terminal, at most."""

SPARSER = 4
"""The share of the elapsed time between two such lines, as a divisor."""

Report = Callable[[int, int], object]
"""Called with the number of finished items and the total."""


@contextlib.contextmanager
def counting(console: Console, title: str, *, announce: bool = False) -> Iterator[Report]:
    """Show a progress bar with the remaining time; occasional lines if `console` is no terminal and no notebook.

    With `announce`, the first of these lines is printed before the work begins.
    """
    if not (console.is_terminal or console.is_jupyter):
        if announce:
            console.print(f"{title}: begins")
        yield _lines(console, title)
        return
    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), "left", TimeRemainingColumn())
    with Progress("{task.description}", *columns, console=console, transient=True) as bar:
        task = bar.add_task(title, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _lines(console: Console, title: str) -> Report:
    """Print a line after finished items: at first often, later every `INTERVAL_S`."""
    began = printed = time.monotonic()
    before: int | None = None

    def report(done: int, total: int) -> None:
        nonlocal began, printed, before
        now = time.monotonic()
        if not before:  # the first item takes longer: programs start, and libraries are loaded
            if before is None or 0 < done < total:
                console.print(f"{title}: {done} of {total}")
            before, began, printed = done, now, now
        elif before < done < total and now - printed >= min((now - began) / SPARSER, INTERVAL_S):
            printed = now
            console.print(
                f"{title}: {done} of {total}, {_left((now - began) / (done - before) * (total - done))} left"
            )

    return report


def _left(seconds: float) -> str:
    """Return a remaining time as text."""
    return f"{seconds / 60:.0f} minutes" if seconds >= 90 else f"{math.ceil(seconds)} s"
