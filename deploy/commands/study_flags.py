"""Flags that commands for many runs share."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Annotated, Any

from deploy.commands.flag_values import named_values
from deploy.commands.flags import option, switch
from deploy.scenario.tables import MAX_RUNS

JobsOption = Annotated[int | None, option("N", "processes (default: one per core)", min=1)]
SchedulerOption = Annotated[
    str | None, option("ADDRESS", "run on the workers of a Dask scheduler, as tcp://10.0.0.1:8786")
]
SeedsOption = Annotated[int | None, option("N", "run the seeds 0 to N - 1", min=1, max=MAX_RUNS)]
SetOption = Annotated[
    list[str] | None,
    option("KEY=VALUE", "a setting of all runs, or a list of its values; repeatable", name="--set"),
]
RetryFlag = Annotated[bool, switch("--retry", "repeat failed runs of the table")]


def other_settings(texts: list[str], study: Callable[..., Any], flags: dict[str, Any]) -> dict[str, Any]:
    """The settings given with --set; ValueError if the command has a flag for one of them."""
    settings = named_values(texts, "set", "radius=0.2")
    for name in settings:
        if name in (*inspect.signature(study).parameters, *flags, "seed"):
            raise ValueError(f"set = '{name}=...': use the flag of this command (--help)")
    return settings
