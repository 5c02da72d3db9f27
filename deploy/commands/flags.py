"""Flags that several commands share, and the help that groups them."""

from __future__ import annotations

import functools
import inspect
import os
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from deploy.commands.console import fail
from deploy.commands.flag_values import items
from deploy.commands.viewing import Viewing
from deploy.run.exit_codes import BAD_INPUT
from worldsim.atomic_files import link_target

Command = Callable[..., None]
Flag = inspect.Parameter
"""A flag of a command: the parameter that receives its value."""

WORLD, ROBOTS, RADIO, RUN, VIEW, FIGURES = "World", "Robots", "Radio", "Run", "View", "Figures and tables"
"""Groups of flags in the help of a command."""


def argument(metavar: str, help: str) -> Any:
    """Describe an argument, a value that has no flag."""
    return typer.Argument(metavar=metavar, help=help)


def option(
    metavar: str,
    help: str,
    group: str | None = None,
    *,
    name: str = "",
    min: float | None = None,
    max: float | None = None,
) -> Any:
    """Describe a flag with a value from `min` to `max`; without a `name`, it is called as its parameter."""
    names = (name,) if name else ()
    return typer.Option(*names, metavar=metavar, help=help, rich_help_panel=group, min=min, max=max)


def switch(name: str, help: str, group: str | None = None) -> Any:
    """Describe a flag without a value."""
    return typer.Option(name, help=help, rich_help_panel=group)


def flag(name: str, kind: Any, help: Any) -> Flag:
    """Return a parameter for the value of a flag, None by default; `help` is the result of `option`."""
    return Flag(name, Flag.KEYWORD_ONLY, default=None, annotation=Annotated[kind | None, help])


def with_flags(command: Command, flags: Sequence[Flag], name: str, make: Callable[..., Any]) -> Command:
    """Give a command flags whose values it receives as one parameter, made by `make`.

    Its own flags follow them; its first parameter, the argument, precedes them.
    """
    first, *rest = [each for each in _parameters(command) if each.name != name]
    every = [each.replace(kind=Flag.KEYWORD_ONLY) for each in (first, *flags, *rest)]

    @functools.wraps(command)
    def called(**given: Any) -> None:
        values = {flag.name: given.pop(flag.name) for flag in flags}
        command(**given, **{name: make(**values)})

    called.__signature__ = inspect.Signature(every)  # type: ignore[attr-defined]
    called.__annotations__ = {each.name: each.annotation for each in every}
    return called


def _parameters(function: Callable[..., Any]) -> list[Flag]:
    return list(inspect.signature(function, eval_str=True).parameters.values())


def command_family() -> typer.Typer:
    """The commands of one module, for `deploy.commands.app` to find by name."""
    return CommandFamily(rich_markup_mode=None)


def subcommands(family: typer.Typer, name: str, help: str) -> typer.Typer:
    """Add a command with subcommands to the commands of a module; return it."""
    parent = CommandFamily(cls=Subcommands, no_args_is_help=True, rich_markup_mode=None, help=help)
    family.add_typer(parent, name=name)
    return parent


def file_option(metavar: str, help: str) -> Any:
    """Return a flag for a file in an existing directory; `metavar`, as ``FILE.csv|.parquet``, has the suffixes."""
    suffixes = re.findall(r"\.\w+", metavar)

    def check(flag: typer.CallbackParam, path: Path | None) -> Path | None:
        if path is not None and (reason := _why_not_written(path, suffixes)):
            fail(f"{flag.name} = {path}: {reason}", BAD_INPUT)
        return path

    return typer.Option(metavar=metavar, callback=check, help=help)


def _why_not_written(path: Path, suffixes: Sequence[str]) -> str:
    """Return why a file cannot be written, or the file that a link leads to; empty if it can."""
    if path.suffix not in suffixes:
        return f"must end in {' or '.join(suffixes)}"
    try:
        folder = link_target(path).parent
        if not folder.is_dir():
            return f"no such folder: {folder}"
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        return f"{reason}; name another"
    return "" if os.access(folder, os.W_OK) else f"nothing can be written in {folder}; name another"


ShareFlag = Annotated[
    bool,
    switch("--share", "serve the page on the local network, for others to watch (docs/dashboard.md)", VIEW),
]
SpeedOption = Annotated[float | None, option("STEPS_PER_S", "maximum speed, for viewing", VIEW)]
PicturesFlag = Annotated[bool, switch("--pictures", "draw the maps over time and the channel load", VIEW)]
ScenarioFile = Annotated[Path | None, argument("SCENARIO.toml", "a scenario file; flags override it")]
OutOption = Annotated[
    Path | None, option("DIR", "run directory (default: a new one under runs/)", name="--out")
]
JsonFlag = Annotated[bool, switch("--json", "print the results as JSON and nothing else")]
ViewAs = Annotated[
    str, option("native|web|file", "type of viewer (default: a window, or a web page without a display)")
]


def view_flags(command: Command) -> Command:
    """Give a command of one run the flags of its view; it receives them as a `Viewing`, the parameter `viewing`."""
    return with_flags(command, _parameters(_viewing), "viewing", _viewing)


def _viewing(
    view: Annotated[bool, switch("--view", "view the run live, in a window or on a web page", VIEW)] = False,
    view_as: Annotated[
        str | None, option("native|web|file", "type of viewer; file: only record", VIEW)
    ] = None,
    share: ShareFlag = False,
    wait_for_viewer: Annotated[
        bool, switch("--wait-for-viewer", "start when a viewer has opened the page, not before", VIEW)
    ] = False,
    keep_serving: Annotated[
        bool,
        switch(
            "--keep-serving", "keep the page open after the run until Ctrl-C; default at a terminal", VIEW
        ),
    ] = False,
) -> Viewing:
    mode = "web" if share or wait_for_viewer or keep_serving else "auto" if view else None
    return Viewing(view_as or mode, share, wait_for_viewer, keep_serving)


def figure_flags(command: Command) -> Command:
    """Give a command the flags of figures and tables; it receives them as a `FigureStyle`, the parameter `style`."""
    return with_flags(command, _parameters(_figure_style), "style", _figure_style)


def _figure_style(
    formats: Annotated[
        str, option("pdf,svg,csv,tex", "also write figures as PDF or SVG, tables as CSV or LaTeX", FIGURES)
    ] = "",
    figure_width: Annotated[
        float | None, option("CM", "width of each figure (default: 11 cm per panel)", FIGURES)
    ] = None,
    font: Annotated[str | None, option("NAME", "font of figures, as serif or Arial", FIGURES)] = None,
    font_size: Annotated[float, option("POINTS", "size of all text in figures", FIGURES)] = 10.0,
) -> Any:
    from deploy.study.figure_style import FigureStyle  # noqa: PLC0415  slow to import

    return FigureStyle(tuple(items(formats)), figure_width, font, font_size)


class Subcommands(TyperGroup):
    """A command with subcommands; its help lists the first sentence of each in full."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the list of subcommands."""
        with formatter.section("Commands"):
            commands = [(name, self.commands[name]) for name in self.list_commands(ctx)]
            formatter.write_dl([(name, each.get_short_help_str(sys.maxsize)) for name, each in commands])


class GroupedCommand(TyperCommand):
    """A command whose help lists flags by group, as plain text; typer itself groups flags only in Rich boxes.

    Arguments are shown by their metavars alone. Typer itself would add the Python type, and a second ``...``.
    """

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Name the options and arguments of a call; those that may be left out are in brackets."""
        arguments = [each for each in self.get_params(ctx) if each.param_type_name == "argument"]
        return [
            "[OPTIONS]",
            *(f"{each.metavar}" if each.required else f"[{each.metavar}]" for each in arguments),
        ]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments, flags without a group, and those of each group, in the order in which groups first occur."""
        groups: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is None:
                continue
            if parameter.param_type_name == "argument":
                groups["Arguments"].append((f"{parameter.metavar}", record[1]))
            else:
                group = getattr(parameter, "rich_help_panel", None) or "Options"
                groups.setdefault(group, []).append(record)
        for group, records in groups.items():
            if records:
                with formatter.section(group):
                    formatter.write_dl(records)


class CommandFamily(typer.Typer):
    """Commands whose help is that of `GroupedCommand`."""

    def command(self, name: str | None = None, **settings: Any) -> Any:
        """Add a command, as `typer.Typer.command` does."""
        return super().command(name, **{"cls": GroupedCommand} | settings)
