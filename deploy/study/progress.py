"""How far long work is, and how long the rest will take."""

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

EVERY_S = 60
"""Where there is no terminal, a line is written this often."""

Tell = Callable[[int, int], object]
"""Called with how much is done, and how much there is."""


@contextlib.contextmanager
def counting(console: Console, what: str) -> Iterator[Tell]:
    """A progress bar with the time left; lines now and then where `console` is no terminal (nor a notebook)."""
    if not (console.is_terminal or console.is_jupyter):
        yield _Lines(console, what).tell
        return
    bar = Progress(
        TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(),
        TimeElapsedColumn(), TextColumn("left"),
        TimeRemainingColumn(elapsed_when_finished=False), console=console, transient=True,
    )  # fmt: skip
    task = bar.add_task(what, total=None)
    with bar:
        yield lambda done, total: bar.update(task, completed=done, total=total)


class _Lines:
    def __init__(self, console: Console, what: str) -> None:
        self._console = console
        self._what = what
        self._began: tuple[float, int] | None = None
        self._said = time.monotonic()

    def tell(self, done: int, total: int) -> None:
        """Write a line, if it is time to."""
        now = time.monotonic()
        if self._began is None:
            self._began = now, done
        elif now - self._said >= EVERY_S:
            began, before = self._began
            self._said = now
            left = (now - began) / (done - before) * (total - done) / 60
            self._console.print(f"{self._what}: {done} of {total}, some {left:.0f} minutes left")
