"""`murmur robot` and `murmur stop`: a robot in the field (docs/field.md)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from deploy.commands.console import fail, screen
from deploy.commands.flags import argument, command_family, switch
from deploy.record.number_texts import counted
from deploy.run.exit_codes import BAD_INPUT, BROKEN_OFF, NOT_FINISHED
from deploy.scenario.errors import ScenarioError

app = command_family()

STOP_S = 30.0
"""Seconds for which `murmur stop` waits for a robot."""


@app.command()
def robot(
    file: Annotated[Path | None, argument("ROBOT.toml", "settings file of this robot")] = None,
    example: Annotated[bool, switch("--example", "print a commented settings file, and exit")] = False,
    check: Annotated[
        bool, switch("--check", "check the settings, the key, and the directories, and exit")
    ] = False,
) -> None:
    """Run one robot of a team in the field: its sensors and motors over ROS 2, its radio without a relay.

    The robot explores until nothing is left and its teammates hold its map. It stands still at the end, on Ctrl-C, on
    murmur stop, and while no readings arrive. Exit codes: 0 explored, 1 not finished, 2 bad input, 3 aborted.
    """
    from deploy.field.robot_file import EXAMPLE, load_robot, radio_text, source  # noqa: PLC0415

    if example:
        print(EXAMPLE.read_text(encoding="utf-8"), end="")
        return
    if file is None:
        fail(
            "name the settings file of the robot, as robot.toml; murmur robot --example prints one", BAD_INPUT
        )
    settings = load_robot(file)
    if check:
        from agent.radios.team_key import read_key  # noqa: PLC0415

        read_key(settings.key)
        settings.check_directories()
        screen.print(f"{file}: robot {settings.settings.robot} of {settings.settings.robots}, no errors")
        screen.print(f"the robot's part of the team's map comes from {source(settings.settings)}")
        screen.print(f"radio: {radio_text(settings.settings)}")
        return
    from deploy.field.mission import explore  # noqa: PLC0415

    ending = explore(settings, screen.print)
    if ending.records is not None:
        screen.print(f"{counted(ending.steps, 'step')}; records in {ending.records}")
    screen.print(f"the robot stands still: {ending.reason}")
    raise typer.Exit(0 if ending.is_complete else NOT_FINISHED)


@app.command()
def stop(
    folders: Annotated[
        list[Path] | None, argument("DIR...", "record directories of robots that run on this host")
    ] = None,
    every: Annotated[bool, switch("--all", "stop all robots of this user on this host")] = False,
) -> None:
    """Stop robots in the field that run on this host: they stand still, write their records, and end.

    This is no emergency stop: a robot needs up to a second, and only its own driver can brake at once.
    """
    from deploy.field import running  # noqa: PLC0415

    if every == bool(folders):
        fail("name the record directory of a robot, or use --all", BAD_INPUT)
    chosen = running.robots() if every else folders or []
    if not chosen:
        screen.print("no robot of this user runs on this host")
    for folder in chosen:
        try:
            running.ask_to_stop(folder)
        except ScenarioError:  # with --all, it may have ended since
            if not every:
                raise
    late = [str(folder) for folder in chosen if not running.has_ended(folder, STOP_S)]
    for folder in chosen:
        if str(folder) not in late:
            screen.print(f"{folder}: stopped")
    if late:
        fail(f"{', '.join(late)}: still running after {STOP_S:.0f} s", BROKEN_OFF)
