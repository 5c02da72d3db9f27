"""What commands say: results and progress, and what a person can mend, with the exit code that goes with it."""

from __future__ import annotations

import errno
import json
from pathlib import Path
from typing import Any, NoReturn

import typer
from rich.console import Console

BAD_INPUT, BROKEN_OFF = 2, 3

errors = Console(stderr=True, highlight=False, soft_wrap=True, markup=False)
screen = Console(highlight=False, soft_wrap=True, markup=False)
"""Without markup: what is printed holds names, paths and last words, whose brackets are their own."""

PAPER_WIDTH = 160
"""Columns of a table that goes to a file or another program."""


def report_result(result: Any, *, as_json: bool) -> int:
    """Print what a run brought; return its exit code."""
    from deploy.commands.terminal import summary_lines  # noqa: PLC0415

    report_deaths(result.deaths)
    if result.view_fault:
        errors.print(f"the viewer broke off, the run did not mind: {result.view_fault}")
    for robot, cause in sorted(result.records.lost.items()):
        errors.print(f"robot {robot} was lost: {cause}")
    for fault in result.records.faults[:5]:
        errors.print(f"nonsense on the air: {fault}")
    if as_json:
        print(json.dumps(result.summary))
    else:
        for line in summary_lines(result.summary, result.directory):
            screen.print(line)
    code: int = result.exit_code
    return code


def report_deaths(deaths: dict[str, str]) -> None:
    """Say which processes died, and their last words."""
    for name, words in deaths.items():
        errors.print(f"{name} died: {words}")


def explain_difference(before: dict[str, Any], now: dict[str, Any]) -> None:
    """Say in what two runs that should be one differ: settings first."""
    from deploy.record.run_directory import MAP  # noqa: PLC0415

    errors.print("The run does not hold: its digest has changed.")
    settings = ("robots", "seed", "map", "strategy", "exchange", "bandwidth", "range_m")
    for key in (*settings, "steps", "coverage", "map_agreement", "bytes", "versions"):
        is_copy = key == "map" and now[key] == Path(MAP).stem
        if before[key] != now[key] and not is_copy:
            errors.print(f"  {key}: {before[key]} then, {now[key]} now")


def progress(*, shown: bool) -> Any:
    """A live line on the error stream, where people see it and pipes do not."""
    from deploy.commands import terminal  # noqa: PLC0415

    return terminal.progress(errors, shown=shown)


class speaking_clearly:  # noqa: N801  reads as the statement that it is
    """Turn what a person can mend into a message: exit code 2 for bad input, 3 for what broke off the work."""

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: object) -> None:
        if isinstance(error, ValueError):
            fail(str(error), BAD_INPUT)
        if isinstance(error, OSError) and not isinstance(error, BrokenPipeError):
            fail(*_explain(error))


def _explain(error: OSError) -> tuple[str, int]:
    """What the system refused, and the exit code: a file of another name mends the one, not the other."""
    if error.filename is None:
        return error.strerror or str(error), BROKEN_OFF
    is_bad_name = error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
    return f"{error.filename}: {error.strerror}", BAD_INPUT if is_bad_name else BROKEN_OFF


def fail(message: str, code: int) -> NoReturn:
    """End the command with a message."""
    for line in message.splitlines():
        errors.print(f"murmur: {line}")
    raise typer.Exit(code)
