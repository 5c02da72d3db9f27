"""`murmur play`: replay logs of real robots, whose maps the team shares."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from deploy.commands.explore import other_settings, run_live
from deploy.commands.flags import (
    RADIO,
    ROBOTS,
    RUN,
    VIEW,
    GroupedCommand,
    JsonFlag,
    OutOption,
    command_family,
    setting_flags,
)
from deploy.scenario.scenario import NOT_RECORDED, NOT_RECORDED_REASON, load
from protocol.presets import PRESETS
from worldsim.recorded.options import PACES

app = command_family()

LOG = "Log"


@app.command(cls=GroupedCommand)
@setting_flags("map", "map_seed", "start", "strategy", "speed", "sensor_range")
def play(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG...", help="a log for the whole team, or one per robot (docs/recorded.md)"
        ),
    ],
    every: Annotated[
        int | None,
        typer.Option(metavar="K", help="replay each K-th scan (default 1)", rich_help_panel=LOG),
    ] = None,
    pace: Annotated[
        str | None,
        typer.Option(
            metavar="|".join(PACES),
            help="scan: one scan per robot and step; recorded: a step is a second of the log (default scan)",
            rich_help_panel=LOG,
        ),
    ] = None,
    topic: Annotated[
        str | None,
        typer.Option(metavar="TOPIC", help="the laser, if a bag has several", rich_help_panel=LOG),
    ] = None,
    resolution: Annotated[
        float | None,
        typer.Option(metavar="METERS", help="cell size of the map (default 0.1)", rich_help_panel=LOG),
    ] = None,
    listeners: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="how many of the robots have no scans, and only receive (default 0)",
            rich_help_panel=LOG,
        ),
    ] = None,
    sensor_range: Annotated[
        float | None,
        typer.Option(
            metavar="METERS", help="range up to which robots map (default 10)", rich_help_panel=ROBOTS
        ),
    ] = None,
    radio: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help=f"a radio preset (bandwidth, frame size, range): {', '.join(PRESETS)}",
            rich_help_panel=RADIO,
        ),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="any other setting, as radio.loss=0.1 or polygons.lazy=false; repeatable",
            rich_help_panel=RUN,
        ),
    ] = None,
    view: Annotated[
        bool,
        typer.Option("--view", help="view the run live, in a window or on a web page", rich_help_panel=VIEW),
    ] = False,
    view_as: Annotated[
        str | None,
        typer.Option(
            metavar="native|web|file", help="type of viewer; file: only record", rich_help_panel=VIEW
        ),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(metavar="STEPS_PER_S", help="maximum speed, for viewing", rich_help_panel=VIEW),
    ] = None,
    pictures: Annotated[
        bool,
        typer.Option("--pictures", help="draw the maps over time and the channel load", rich_help_panel=VIEW),
    ] = False,
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
    raise typer.Exit(run_live(scenario, view_type, None, choices, pictures=pictures, as_json=as_json))
