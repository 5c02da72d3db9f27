"""`murmur play`: replay logs of real robots, whose maps the team shares."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from deploy.commands import flags
from deploy.commands.explore import run_live
from deploy.commands.flags import ROBOTS, argument, command_family, flag, option, view_flags
from deploy.commands.scenario_flags import run_flags
from deploy.commands.viewing import Viewing
from deploy.scenario.scenario import NOT_RECORDED, NOT_RECORDED_REASON, load
from worldsim.recorded.options import PACES

app = command_family()

LOG = "Log"
PACE_HELP = "scan: one scan per robot and step; recorded: a step is a second of the log"
NOT_PLAYED = (
    "map", "map_seed", "map_options.resolution", "start", "strategy", "speed", "min_frontier_size", "finish",
    "laser.preset", "pose.preset", "people.number",
)  # fmt: skip
"""Settings of which this command has no flag."""
LOG_FLAGS = {
    "recording.every": flag("every", int, option("K", "replay each K-th scan (default 1)", LOG)),
    "recording.pace": flag("pace", str, option("|".join(PACES), f"{PACE_HELP} (default scan)", LOG)),
    "recording.topic": flag(
        "topic", str, option("TOPIC", "the laser, if a bag has several; A,B: a robot for each of them", LOG)
    ),
    "recording.resolution": flag(
        "resolution", float, option("METERS", "cell size of the map (default 0.1)", LOG)
    ),
    "recording.listeners": flag(
        "listeners",
        int,
        option("N", "how many of the robots have no scans, and only receive (default 0)", LOG),
    ),
    "sensor_range": flag(
        "sensor_range", float, option("METERS", "range up to which robots map (default 10)", ROBOTS)
    ),
}


@app.command()
@run_flags(*NOT_PLAYED, more=LOG_FLAGS)
@view_flags
def play(
    logs: Annotated[
        list[Path], argument("LOG...", "a log for the whole team, or one per robot (docs/recorded.md)")
    ],
    rate: flags.SpeedOption = None,
    pictures: flags.PicturesFlag = False,
    out: flags.OutOption = None,
    as_json: flags.JsonFlag = False,
    *,
    settings: dict[str, Any],
    viewing: Viewing,
) -> None:
    """Replay logs of real robots: each robot takes the scans of its part of the log, and the team shares its maps.

    Robots do not plan or drive. The run ends when all scans are replayed, and teammates hold all maps. The run
    directory contains the scans, so `murmur replay` repeats the run without the logs. docs/recorded.md describes
    formats and results.
    """
    for name in settings:
        if name.partition(".")[0] in (*NOT_RECORDED, "map", "strategy", "min_frontier_size"):
            raise ValueError(f"set = '{name}=...': {NOT_RECORDED_REASON}")
    scenario = load(None, settings | {"recording.files": [str(path) for path in logs]})
    choices = {"out": out, "pace": rate}
    raise typer.Exit(run_live(scenario, viewing, None, choices, pictures=pictures, as_json=as_json))
