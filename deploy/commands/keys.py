"""`murmur keys`: certificates that authenticate the participants of a run (docs/hosts.md)."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

from deploy.commands.console import screen
from deploy.commands.flags import argument, command_family, option
from deploy.scenario.errors import ScenarioError
from protocol import keys as names
from protocol.grid import MAX_ROBOTS

app = command_family()


@app.command()
def keys(
    directory: Annotated[Path, argument("DIR", "output folder; existing files are kept")] = Path("keys"),
    robots: Annotated[int, option("N", "number of robots", min=1, max=MAX_ROBOTS)] = 3,
    address: Annotated[
        list[str] | None, option("HOST", "address of the hub; repeatable (default 127.0.0.1)")
    ] = None,
    router: Annotated[
        list[str] | None,
        option("NAME=0,1,...", "robots that join through router NAME (murmur run router); repeatable"),
    ] = None,
    days: Annotated[int, option("N", "days until they expire", min=1, max=3650)] = 30,
    team_key: Annotated[
        Path | None, option("FILE", "create only this file: the key of a team in the field")
    ] = None,
) -> None:
    """Create a certificate authority for a run, and a certificate and private key for each participant.

    The authority's key is not stored, so that certificates cannot be added later. Use it for processes started by hand
    (murmur run netshaper --keys DIR); `murmur explore --hosts` creates its own certificates for each run.

    Robots without a relay need no certificates, but a key that all of them have (--team-key, docs/field.md).
    """
    if team_key is not None:
        from agent.radios.team_key import create_key  # noqa: PLC0415

        create_key(team_key)
        screen.print(f"{team_key}: copy it to each robot of the team; whoever has it can send in their names")
        return
    from netshaper import certificates  # noqa: PLC0415

    known_as = address or ["127.0.0.1"]
    made = certificates.make(robots, known_as, days, _routers(router or [], robots))
    try:
        written = certificates.write(made, directory)
    except FileExistsError as error:
        raise ScenarioError(f"{error.filename} already exists, and is kept; name a new directory") from None
    host = f"[{known_as[0]}]" if ":" in known_as[0] else known_as[0]
    screen.print(
        f"{len(written)} files in {directory}, for a hub at {', '.join(known_as)}; valid for {days} days.\n"
        f"Next: murmur run netshaper SCENARIO --listen {host}:7447 --keys {directory}"
    )


def _routers(given: list[str], robots: int) -> dict[str, list[str]]:
    """Parse --router: the names of the robots behind each router."""
    found: dict[str, list[str]] = {}
    for text in given:
        parts = re.fullmatch(r"([A-Za-z0-9][A-Za-z0-9._-]*)=([0-9]{1,4}(?:,[0-9]{1,4})*)", text)
        if parts is None:
            raise ScenarioError(f"router = {text!r}: must be NAME=0,1,..., as rack-1=0,1")
        found[names.router(parts[1])] = [names.robot(int(number)) for number in parts[2].split(",")]
    behind = [robot for robots_behind in found.values() for robot in robots_behind]
    for robot in behind:
        if behind.count(robot) > 1 or names.number(robot) >= robots:
            raise ScenarioError(
                f"router = {' '.join(given)}: {robot} must be one of the {robots} robots, and behind one router"
            )
    return found
