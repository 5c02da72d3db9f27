"""Flags that commands for many runs share, and the parsing of their lists."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import Annotated, Any

import typer

from deploy.commands.flags import items, named_values
from deploy.scenario.tables import MAX_RUNS

JobsOption = Annotated[int | None, typer.Option(min=1, metavar="N", help="processes (default: one per core)")]
SchedulerOption = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="run on the workers of a Dask scheduler, as tcp://10.0.0.1:8786"),
]
SeedsOption = Annotated[
    int | None, typer.Option(min=1, max=MAX_RUNS, metavar="N", help="run the seeds 0 to N - 1")
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="a setting of all runs, or a list of its values; repeatable"
    ),
]
RetryFlag = Annotated[bool, typer.Option("--retry", help="repeat failed runs of the table")]


def other_settings(
    texts: list[str], study: Callable[..., Any], example: str, flags: dict[str, Any]
) -> dict[str, Any]:
    """The settings given with --set; ValueError if the command has a flag for one of them."""
    settings = named_values(texts, "set", example)
    for name in settings:
        if name in (*inspect.signature(study).parameters, *flags, "seed"):
            raise ValueError(f"set = '{name}=...': use the flag of this command (--help)")
    return settings


def whole_numbers(text: str, flag: str, most: int) -> list[int]:
    """Parse ``2..8`` or ``2,4,8``; ValueError if it is neither, or a number exceeds `most`."""
    first, dots, last = text.partition("..")
    try:
        numbers: Sequence[int] = (
            range(int(first), int(last) + 1) if dots else [int(item) for item in items(text)]
        )
    except ValueError:
        numbers = []
    if not numbers or max(numbers[0], numbers[-1]) > most:
        raise ValueError(f"{flag} = {text!r}: must be whole numbers of at most {most}, as 2..8 or 2,4,8")
    return list(numbers)
