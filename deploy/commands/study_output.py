"""The end of commands for many runs: tables of results, causes of failed runs, and exit codes."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import typer
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Column, Table

from deploy.commands.console import errors, fail, screen
from deploy.record.number_texts import counted
from deploy.run.exit_codes import BROKEN_OFF, INTERRUPTED

FILE_WIDTH = 160
"""Columns of a table printed to a file or another program."""


def report_sweep(sweep: Any) -> None:
    """Print the causes of a sweep's failed runs, and its table of means; end the command if all runs failed."""
    from deploy.study.tables import tabulate  # noqa: PLC0415

    report_failures(sweep.failures)
    table, runs = sweep.experiment.table, len(sweep.rows)
    if not runs and sweep.failures:
        fail("all runs failed", BROKEN_OFF)
    if runs:
        made = f"{runs} of {len(sweep.cases)} runs" if runs < len(sweep.cases) else counted(runs, "run")
        intervals = ", with 95 % intervals" if table.interval else ""
        screen.print(f"{made}; means of n each{intervals}:")
        print_table(tabulate(table, sweep.rows))


@contextmanager
def stopping(out: Path | None) -> Iterator[None]:
    """On Ctrl-C, SIGTERM, or SIGHUP, print how to continue."""
    from deploy.run.interrupt import signals_as_ctrl_c  # noqa: PLC0415  loads the recorder

    try:
        with signals_as_ctrl_c():
            yield
    except KeyboardInterrupt:
        fail("stopped" + (f"; the same command continues from {out}" if out is not None else ""), INTERRUPTED)


def end_study(failures: Collection[str], code: int = 0) -> NoReturn:
    """End the command with exit code `code`, or with `BROKEN_OFF` if there are failures (causes of failed runs)."""
    raise typer.Exit(BROKEN_OFF if failures else code)


def print_table(lines: list[list[str]]) -> None:
    """Print a table, header first, as wide as the terminal or `FILE_WIDTH`.

    A table that is wider is turned, with a line per column, if that is narrower. If it is still wider, names are
    wrapped between their words; if that is not enough either, the turned table is printed in parts, as many columns in
    each as fit.
    """
    paper = screen if screen.is_terminal else Console(width=FILE_WIDTH, highlight=False, markup=False)
    turned = [list(column) for column in zip(*lines, strict=True)]
    both = [[*map(_wrapped, turned[0])], *([_wrapped(line[0]), *line[1:]] for line in turned[1:])]
    forms = (lines, turned, [[*map(_wrapped, lines[0])], *lines[1:]], both)
    fitting = (form for form in forms if _width(form) <= paper.width)
    for part in _parts(next(fitting, both), paper.width):
        table = Table(*(Column(head, overflow="fold") for head in part[0]), box=SIMPLE)
        for line in part[1:]:
            table.add_row(*line)
        paper.print(table)


def _parts(lines: list[list[str]], width: int) -> list[list[list[str]]]:
    """Split a table into tables of some of its columns, the first one repeated, that are at most `width` wide."""
    first, *columns = zip(*lines, strict=True)
    parts = [[first]]
    for column in columns:
        if len(parts[-1]) > 1 and _width([*zip(*parts[-1], column, strict=True)]) > width:
            parts.append([first])
        parts[-1].append(column)
    return [[list(line) for line in zip(*part, strict=True)] for part in parts]


def _width(lines: Sequence[Sequence[str]]) -> int:
    """The width of a table whose cells may have line breaks: columns have two spaces between them and at both ends."""
    columns = zip(*lines, strict=True)
    return 2 + sum(3 + max(len(line) for cell in column for line in cell.split("\n")) for column in columns)


def _wrapped(name: str) -> str:
    """The name of a column, with each of its words on a line."""
    return re.sub(r"(?<=[a-z])([_.])(?=[a-z])", r"\1\n", name)


def report_failures(causes: dict[str, int]) -> None:
    """Print the causes of failed runs."""
    for cause, count in causes.items():
        errors.print(f"{count} run{'s' if count > 1 else ''} failed: {cause}")
