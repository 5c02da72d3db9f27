"""`murmur keys`: the certificates by which the participants of a run know each other (docs/hosts.md)."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

import typer

from deploy.commands.console import report_user_errors, screen
from deploy.commands.flags import family
from deploy.scenario.scenario import ScenarioError
from protocol import keys as names

app = family()


@app.command()
def keys(
    directory: Annotated[
        Path, typer.Argument(metavar="DIR", help="where they go; nothing there is overwritten")
    ] = Path("keys"),
    robots: Annotated[int, typer.Option(metavar="N", min=1, help="how many robots the run has")] = 3,
    address: Annotated[
        list[str] | None,
        typer.Option(metavar="HOST", help="where participants reach the hub; repeatable (default 127.0.0.1)"),
    ] = None,
    router: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=0,1,...",
            help="these robots join through a router of that name (murmur run router); repeatable",
        ),
    ] = None,
    days: Annotated[int, typer.Option(metavar="N", min=1, max=3650, help="for how long they hold")] = 30,
) -> None:
    """Make a run's own authority, and one certificate and private key a participant.

    The authority's key is not kept: what is not made now cannot be added. `murmur explore --hosts` makes its own
    anew for each run and needs none of this; it is for processes started by hand (murmur run netshaper --keys DIR).
    """
    from netshaper import certificates  # noqa: PLC0415

    with report_user_errors():
        known_as = address or ["127.0.0.1"]
        made = certificates.make(robots, known_as, days, _routers(router or [], robots))
        written = certificates.write(made, directory)
        screen.print(
            f"{len(written)} files in {directory}, for a hub at {', '.join(known_as)}; they hold {days} days.\n"
            f"murmur run netshaper --keys {directory} puts each one's into its credential."
        )


def _routers(given: list[str], robots: int) -> dict[str, list[str]]:
    """The robots' names behind each router, by its name."""
    found: dict[str, list[str]] = {}
    for text in given:
        parts = re.fullmatch(r"([A-Za-z0-9][A-Za-z0-9._-]*)=([0-9]{1,4}(?:,[0-9]{1,4})*)", text)
        if parts is None:
            raise ScenarioError(f"router = {text!r}: must be NAME=0,1,..., as rack-1=0,1")
        found[names.router(parts[1])] = [names.robot(int(number)) for number in parts[2].split(",")]
    behind = [robot for speaks_for in found.values() for robot in speaks_for]
    for robot in behind:
        if behind.count(robot) > 1 or names.number(robot) >= robots:
            raise ScenarioError(
                f"router = {' '.join(given)}: {robot} must be one of the {robots} robots, and behind one router"
            )
    return found
