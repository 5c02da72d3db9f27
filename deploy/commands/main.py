"""`murmur` and its commands: a table of names, and where each is found when it is called.

Nothing of a command is imported before it is asked for, so that help and short commands come at once.
"""

from __future__ import annotations

import importlib
from typing import Annotated, Any, NamedTuple

import typer
from typer.core import TyperGroup

PACKAGE = "murmur-robots"
"""The distribution's name."""


class Place(NamedTuple):
    """Where a command is, and what the list of commands says of it."""

    module: str
    line: str


COMMANDS = {
    "explore": Place("explore", "Explore a building with a swarm of robots, and watch them finish."),
    "watch": Place("explore", "Look at a run that is under way, or at the recording of one."),
    "strategies": Place("strategies", "List the exploration strategies, or show one with all its options."),
    "map": Place("maps", "List, make and show maps."),
    "report": Place("after_run", "Draw a run and write one HTML page of it all."),
    "capture": Place("after_run", "Show what was said on the radio of a run, frame by frame."),
    "export": Place("after_run", "Write a run in a form that other programs open."),
    "replay": Place("after_run", "Repeat a run and check that its digest comes out again."),
    "sweep": Place("studies", "Run a scenario over a grid of settings and print the table asked for."),
    "keys": Place("keys", "Make the certificates of a run whose hub asks for them."),
    "run": Place("by_hand", "Start one process of a run by hand."),
    "bench": Place("machine", "Measure this machine, in ratios against yardsticks of the same run."),
    "doctor": Place("machine", "Check that this installation works."),
}


class Commands(TyperGroup):
    """The commands of `COMMANDS`, each imported when it is asked for."""

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002
        """All names, in the order of the table."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Import a command; None if there is none of that name."""
        if cmd_name not in COMMANDS:
            return None
        family = importlib.import_module(f"deploy.commands.{COMMANDS[cmd_name].module}")
        return typer.main.get_group(family.app).get_command(ctx, cmd_name)

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ARG002
        """Write the list for help, without importing any."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, place.line) for name, place in COMMANDS.items()])


app = typer.Typer(
    name="murmur",
    cls=Commands,
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="""Robot swarms that map a building together over a radio of a kilobyte a second.

    \b
    Begin with:  murmur explore --robots 5        (an office, seen and shared by five robots)
    then look at the picture that it names, and at:  murmur map list,  murmur strategies,  murmur doctor

    Exit codes: 0 explored, 1 not finished (or a replay that does not hold), 2 bad input, 3 a process died
    or the disk is full.""",
)


def _version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version  # noqa: PLC0415

        print(f"murmur {version(PACKAGE)}")
        raise typer.Exit


@app.callback()
def murmur(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="print the version and exit")
    ] = False,
) -> None:
    """Where all commands begin; what it is to say is the help of `app`."""


def main() -> None:
    """Entry point of the `murmur` command."""
    app()


if __name__ == "__main__":
    main()
