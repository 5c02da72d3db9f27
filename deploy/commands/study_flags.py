"""Flags that commands for many runs share."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Annotated, Any

import typer

from deploy.commands.flag_values import named_values
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


def other_settings(texts: list[str], study: Callable[..., Any], flags: dict[str, Any]) -> dict[str, Any]:
    """The settings given with --set; ValueError if the command has a flag for one of them."""
    settings = named_values(texts, "set", "radius=0.2")
    for name in settings:
        if name in (*inspect.signature(study).parameters, *flags, "seed"):
            raise ValueError(f"set = '{name}=...': use the flag of this command (--help)")
    return settings
