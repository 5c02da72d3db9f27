"""The `murmur` command: a table of its commands, and the module that implements each.

A command is imported only when it is called, so that help and short commands start quickly.
"""

from __future__ import annotations

import importlib
from functools import cache
from typing import Annotated, Any, NamedTuple

import typer
from typer.core import TyperGroup

from protocol.numba_import import check_compiler

PACKAGE = "murmur-robots"

DASHES = "\u2010\u2011\u2012\u2013\u2014\u2212"
"""Characters that look like the hyphen of a flag: text programs write them instead."""


class Entry(NamedTuple):
    """A command's module, and its line in the list of commands."""

    module: str
    line: str


COMMANDS = {
    "explore": Entry("explore", "Explore a building with a swarm of robots."),
    "play": Entry("play", "Replay logs of real robots, whose maps the team shares."),
    "watch": Entry("explore", "View a run in progress, or the recording of one."),
    "strategies": Entry("strategies", "List the exploration strategies, or show one with all its options."),
    "new": Entry("new", "Write a template of a new strategy, with its test."),
    "map": Entry("maps", "List, make and show maps."),
    "radio": Entry("radios", "List radio presets, and show their coverage of a building."),
    "report": Entry(
        "after_run", "Write an HTML page of a run, with pictures and a slider; or compare two runs."
    ),
    "movie": Entry("after_run", "Film a run, step by step, or two side by side."),
    "capture": Entry("after_run", "Show the radio traffic of a run, frame by frame."),
    "merge": Entry("after_run", "Join what robots in the field recorded into one run directory."),
    "export": Entry("after_run", "Export a run to formats of other programs."),
    "replay": Entry("after_run", "Repeat a run and check that its digest is the same."),
    "sweep": Entry("studies", "Run a scenario over a grid of settings and print a table."),
    "compare": Entry("studies", "Compare scenarios, strategies, map encodings or radios on the same seeds."),
    "size": Entry("studies", "Find the smallest sufficient team for a building, or for each radio."),
    "tune": Entry("tune", "Search for the weights of a strategy by runs on training seeds."),
    "reproduce": Entry("studies", "Repeat the experiments of the papers, and judge their claims."),
    "chaos": Entry("chaos", "Run swarms under random faults, and check their invariants."),
    "robot": Entry("robot", "Run one robot of a team in the field."),
    "stop": Entry("robot", "Stop robots in the field that run on this host."),
    "keys": Entry("keys", "Create certificates for a run, or the key of a team in the field."),
    "serve-ros2": Entry("serve", "Serve simulated robots that look like ROS 2 robots over Zenoh."),
    "run": Entry("by_hand", "Start one process of a run by hand."),
    "bench": Entry("bench", "Benchmark this machine: ratios to references of the same run."),
    "setup": Entry("machine", "Compile the kernels for this machine, once."),
    "doctor": Entry("machine", "Check that this installation works."),
}


@cache
def _group(module: str) -> Any:
    """Import a module of commands, and build its group of click commands."""
    return typer.main.get_group(importlib.import_module(f"deploy.commands.{module}").app)


class Commands(TyperGroup):
    """The commands of `COMMANDS`, each imported when it is called."""

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002
        """All names, in the order of the table."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Import a command; None if the name is unknown."""
        if cmd_name not in COMMANDS:
            return None
        return _group(COMMANDS[cmd_name].module).get_command(ctx, cmd_name)

    def invoke(self, ctx: Any) -> Any:
        """Run a command; report errors that the user can fix."""
        from deploy.commands.console import report_user_errors  # noqa: PLC0415  imports Rich, which help does not need
        from deploy.run.limits import check_memory  # noqa: PLC0415

        with report_user_errors():
            check_compiler()
            check_memory()
            return super().invoke(ctx)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find a command; for an unknown name, suggest similar ones. Reject flags with a dash instead of hyphens."""
        for each in args:
            if each.startswith(tuple(DASHES)):
                ctx.fail(
                    f"{each!r} begins with a dash; type it with hyphens, as --{each.strip(DASHES + '-')}"
                )
        if args and args[0] not in COMMANDS and not args[0].startswith("-"):
            from protocol.errors import there_are  # noqa: PLC0415

            ctx.fail(f"no such command: {args[0]!r}; {there_are(COMMANDS, args[0])}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ARG002
        """Write the list of commands for help, without importing any."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, entry.line) for name, entry in COMMANDS.items()])


app = typer.Typer(
    name="murmur",
    cls=Commands,
    no_args_is_help=True,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="""Robot swarms that map a building together over a radio of fifty bytes per second.

    \b
    Start with:  murmur explore --robots 5        (five robots explore and map an office)
    Then open the picture that it prints, and try:  murmur map list,  murmur strategies,  murmur doctor

    Exit codes: 0 explored, 1 not finished (or replay differs), 2 bad input, 3 a process died or the disk
    is full.""",
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
    """The root command; its help text is that of `app`."""
