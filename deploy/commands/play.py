"""`murmur play`: replay logs of real robots, whose maps the team shares."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from deploy.commands.explore import other_settings, run_live
from deploy.commands.flags import (
    ROBOTS,
    GroupedCommand,
    JsonFlag,
    OutOption,
    PicturesFlag,
    RadioOption,
    SetOption,
    SpeedOption,
    ViewAsOption,
    ViewFlag,
    command_family,
    option,
    setting_flags,
)
from deploy.commands.viewing import Viewing
from deploy.scenario.scenario import NOT_RECORDED, NOT_RECORDED_REASON, load
from worldsim.recorded.options import PACES

app = command_family()

LOG = "Log"


@app.command(cls=GroupedCommand)
@setting_flags("map", "map_seed", "start", "strategy", "speed", "sensor_range", "finish")
def play(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG...", help="a log for the whole team, or one per robot (docs/recorded.md)"
        ),
    ],
    every: Annotated[int | None, option("K", "replay each K-th scan (default 1)", LOG)] = None,
    pace: Annotated[
        str | None,
        option(
            "|".join(PACES),
            "scan: one scan per robot and step; recorded: a step is a second of the log (default scan)",
            LOG,
        ),
    ] = None,
    topic: Annotated[str | None, option("TOPIC", "the laser, if a bag has several", LOG)] = None,
    resolution: Annotated[float | None, option("METERS", "cell size of the map (default 0.1)", LOG)] = None,
    listeners: Annotated[
        int | None, option("N", "how many of the robots have no scans, and only receive (default 0)", LOG)
    ] = None,
    sensor_range: Annotated[
        float | None, option("METERS", "range up to which robots map (default 10)", ROBOTS)
    ] = None,
    radio: RadioOption = None,
    set_: SetOption = None,
    view: ViewFlag = False,
    view_as: ViewAsOption = None,
    rate: SpeedOption = None,
    pictures: PicturesFlag = False,
    out: OutOption = None,
    as_json: JsonFlag = False,
    *,
    settings: dict[str, Any],
) -> None:
    """Replay logs of real robots: each robot takes the scans of its part of the log, and the team shares its maps.

    Robots do not plan or drive. The run ends when all scans are replayed, and teammates hold all maps. The run
    directory contains the scans, so `murmur replay` repeats the run without the logs. docs/recorded.md describes
    formats and results.
    """
    overrides = settings | other_settings(set_ or [], settings)
    for name in overrides:
        if name.partition(".")[0] in (*NOT_RECORDED, "map", "strategy"):
            raise ValueError(f"set = '{name}=...': {NOT_RECORDED_REASON}")
    given: dict[str, Any] = {
        "recording.every": every, "recording.pace": pace, "recording.topic": topic,
        "recording.resolution": resolution, "recording.listeners": listeners, "sensor_range": sensor_range,
        "radio.preset": radio,
    }  # fmt: skip
    given = {name: value for name, value in given.items() if value is not None}
    for name in sorted(given.keys() & overrides.keys()):
        raise ValueError(f"set = '{name}=...': a flag of murmur play sets it; remove one of them")
    overrides |= given | {"recording.files": [str(path) for path in logs]}
    scenario = load(None, overrides)
    view_type = view_as or ("auto" if view else None)
    choices = {"out": out, "pace": rate}
    raise typer.Exit(
        run_live(scenario, Viewing(view_type), None, choices, pictures=pictures, as_json=as_json)
    )
