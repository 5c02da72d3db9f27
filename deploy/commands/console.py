"""Terminal output of commands: results, progress, and errors that the user can fix, with their exit codes."""

from __future__ import annotations

import contextlib
import json
import os
import sys
import textwrap
import traceback
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NoReturn

import typer
from rich.console import Console
from rich.text import Text

from deploy.run.exit_codes import BAD_INPUT, BROKEN_OFF, INTERRUPTED
from deploy.run.failure import RunFailed
from worldsim.atomic_files import DISK_ERRORS
from worldsim.ending import OUT_OF_STEPS

errors = Console(stderr=True, highlight=False, soft_wrap=True, markup=False)
screen = Console(highlight=False, soft_wrap=True, markup=False)
"""Without markup, because names, paths and process output may contain brackets."""


def report_result(result: Any, *, as_json: bool) -> int:
    """Print the results of a run; return its exit code."""
    from deploy.commands.terminal import standstill, summary_lines  # noqa: PLC0415
    from deploy.record.run_directory import LOGS  # noqa: PLC0415
    from deploy.record.summary import TOO_EARLY  # noqa: PLC0415

    report_deaths(result.deaths, result.directory / LOGS if result.directory is not None else None)
    if result.view_fault:
        errors.print(f"the viewer failed, the run was not affected: {result.view_fault}")
    for robot, cause in sorted(result.records.lost.items()):
        errors.print(f"robot {robot} was lost: {cause}")
    for step, robot in result.records.reconnected:
        errors.print(f"the connection of robot {robot} was cut in step {step} and restored")
    for fault in result.records.protocol_errors.texts[:5]:
        errors.print(f"protocol error: {fault}")
    is_simulated = "scans" not in result.summary
    if is_simulated and result.summary["reason"] == OUT_OF_STEPS and (note := standstill(result.records)):
        errors.print(note)
    size = result.plan.scenario.min_frontier_size
    if size and result.summary["reason"].endswith(TOO_EARLY):
        errors.print(
            f"min_frontier_size = {size:g} m may close passages: choose less than the width of the narrowest one"
        )
    if as_json:
        print(json.dumps(result.summary))
    else:
        noisy = result.plan.scenario.is_noisy
        for line in summary_lines(result.summary, result.directory, noisy=noisy):
            screen.print(line)
    code: int = result.exit_code
    return code


def report_deaths(deaths: dict[str, str], logs: Path | None = None) -> None:
    """Print the processes that died, with their last output, and the log files in folder `logs`."""
    names_by_output: dict[str, list[str]] = {}
    for name, output in deaths.items():
        names_by_output.setdefault(output, []).append(name)
    for output, names in names_by_output.items():
        errors.print(f"{', '.join(names)} died: {output}")
        if "\n" in output and logs is not None:
            errors.print(f"full output: {', '.join(str(logs / f'{name}.log') for name in names)}")


def explain_difference(before: dict[str, Any], now: dict[str, Any]) -> None:
    """Print the differences between two runs that should be equal: settings first."""
    from deploy.record.run_directory import MAP  # noqa: PLC0415

    errors.print("Replay differs: the digest has changed.")
    settings = ("robots", "seed", "map", "strategy", "map_encoding", "bandwidth", "range_m")
    for key in (*settings, "steps", "coverage", "map_accuracy", "bytes", "versions"):
        is_copy = key == "map" and now[key] == Path(MAP).stem
        if before[key] != now[key] and not is_copy:
            errors.print(f"  {key}: was {before[key]}, is {now[key]}")


def print_entries(entries: Mapping[str, str]) -> None:
    """Print names and descriptions, wrapped beside the names on a terminal; elsewhere, a line each, as grep expects."""
    width = max(screen.width, 60) if screen.is_terminal else sys.maxsize
    column = max(map(len, entries)) + 2
    indent = " " * column
    for name, description in entries.items():
        text = textwrap.fill(
            description, width, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False
        )
        screen.print(Text.assemble((f"{name:{column}}", "bold"), text[column:]))


def progress(*, shown: bool, message: Callable[[], str] = lambda: "") -> Any:
    """A progress line with a `message` below it, on the error stream, which is not piped to other programs."""
    from deploy.commands import terminal  # noqa: PLC0415

    return terminal.progress(errors, shown=shown, message=message)


@contextlib.contextmanager
def report_user_errors() -> Iterator[None]:
    """Turn Ctrl-C and errors that the user can fix into a message: exit code 2 for bad input, 3 for aborted work.

    With the environment variable ``MURMUR_TRACEBACK``, the traceback of a ValueError is printed too.
    """
    try:
        yield
    except ValueError as error:
        if os.environ.get("MURMUR_TRACEBACK"):
            traceback.print_exc()
        fail(str(error), BAD_INPUT)
    except RunFailed as error:
        fail(str(error), BROKEN_OFF)
    except RecursionError:
        fail("input nested too deeply", BAD_INPUT)
    except MemoryError:
        from deploy.run.limits import out_of_memory  # noqa: PLC0415

        fail(out_of_memory(), BROKEN_OFF)
    except KeyboardInterrupt:
        fail("interrupted", INTERRUPTED)
    except BrokenPipeError:
        raise
    except OSError as error:
        fail(*_explain(error))


def _explain(error: OSError) -> tuple[str, int]:
    """The system's error and the exit code: bad input if another file name would help, else aborted."""
    if error.filename is None:
        return error.strerror or str(error), BROKEN_OFF
    return f"{error.filename}: {error.strerror}", BROKEN_OFF if error.errno in DISK_ERRORS else BAD_INPUT


def fail(message: str, code: int) -> NoReturn:
    """End the command with a message."""
    for line in message.splitlines():
        errors.print(f"murmur: {line}")
    raise typer.Exit(code)
