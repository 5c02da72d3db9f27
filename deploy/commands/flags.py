"""Flags shared by several commands: those derived from the scenario's settings, and the parsing of values."""

from __future__ import annotations

import functools
import inspect
import json
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from deploy.commands.console import BAD_INPUT, fail
from protocol.presets import PRESETS
from worldsim.sensor_options import LASERS, POSES

SETTINGS = {
    "World": {"map": "FILE|NAME", "map_seed": "S", "start": "X,Y"},
    "Robots": {"robots": "N", "strategy": "NAME", "sensor_range": "METERS", "speed": "METERS"},
    "Radio": {
        "range": "METERS|P%", "bandwidth": "BYTES|unlimited", "map_encoding": "NAME", "dissemination": "NAME",
        "tolerance": "CELLS",
    },
    "Run": {
        "seed": "S", "steps": "MAX", "finish": "first|all", "bus": "zenoh|memory", "clock": "barrier|wall",
    },
}  # fmt: skip
"""Settings of a scenario with a flag of their own, by group of the help, each with the metavar of its value."""

WORLD, ROBOTS, RADIO, RUN = SETTINGS
VIEW, FIGURES = "View", "Figures and tables"
"""Groups of flags in the help of a command."""


def option(metavar: str, help: str, group: str, *names: str) -> Any:
    """Return a flag with a value."""
    return typer.Option(*names, metavar=metavar, help=help, rich_help_panel=group)


def switch(name: str, help: str, group: str) -> Any:
    """Return a flag without a value."""
    return typer.Option(name, help=help, rich_help_panel=group)


def setting_flags(*without: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command a flag for each of `SETTINGS` but those in `without`.

    The command receives the settings that the user gave as the dictionary `settings`.
    """

    flags = [
        (name, _flag(name, metavar, group), None)
        for group, names in SETTINGS.items()
        for name, metavar in names.items()
        if name not in without
    ]

    def given(**values: Any) -> dict[str, Any]:
        settings = {name: value for name, value in values.items() if value is not None}
        if "start" in settings:
            settings["start"] = position(settings["start"])
        return settings

    return lambda command: _with_flags(command, flags, "settings", given)


def figure_flags(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the flags of figures and tables; it receives them as a `FigureStyle`, the parameter `style`."""

    def style(formats: str, figure_width: float | None, font: str | None, font_size: float) -> Any:
        from deploy.study.figure_style import FigureStyle  # noqa: PLC0415  slow to import

        names = tuple(name.strip() for name in formats.split(",") if name.strip())
        return FigureStyle(names, figure_width, font, font_size)

    return _with_flags(command, FIGURE_FLAGS, "style", style)


def _with_flags(
    command: Callable[..., None], flags: Sequence[tuple[str, Any, Any]], name: str, make: Callable[..., Any]
) -> Callable[..., None]:
    """Give a command flags (name, annotation, default) whose values it receives as one parameter, made by `make`.

    Its own flags follow them; its first parameter, the argument, precedes them.
    """
    own = inspect.signature(command, eval_str=True).parameters
    first, *rest = [(each.name, each.annotation, each.default) for each in own.values() if each.name != name]
    every = [first, *flags, *rest]

    @functools.wraps(command)
    def with_flags(**given: Any) -> None:
        values = {flag: given.pop(flag) for flag, *_ in flags}
        command(**given, **{name: make(**values)})

    with_flags.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [
            inspect.Parameter(flag, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
            for flag, annotation, default in every
        ]
    )
    with_flags.__annotations__ = {flag: annotation for flag, annotation, _ in every}
    return with_flags


def _flag(name: str, metavar: str, group: str) -> Any:
    """The annotation of a setting's flag: its type, its description and its default."""
    from deploy.scenario.scenario import Scenario  # noqa: PLC0415  not all commands have settings

    info = Scenario.model_fields[name]
    kind = info.annotation if info.annotation in (int, float) else str
    has_default = info.default is not None and info.default_factory is None
    text = f"{info.description}" + (f" (default {info.default})" if has_default else "")
    flag = "--" + name.replace("_", "-")
    return Annotated[kind | None, typer.Option(flag, help=text, metavar=metavar, rich_help_panel=group)]


def command_family() -> typer.Typer:
    """The commands of one module, for `deploy.commands.app` to find by name."""
    return typer.Typer(rich_markup_mode=None)


def preformatted(text: str) -> str:
    """Text whose line breaks help keeps."""
    return text.replace("\n\n", "\n\n\b\n")


def output_file(*suffixes: str) -> Callable[[typer.CallbackParam, Path | None], Path | None]:
    """The check of a flag that names an output file: its suffix, and that its folder exists."""

    def checked(flag: typer.CallbackParam, path: Path | None) -> Path | None:
        if path is not None and path.suffix not in suffixes:
            fail(f"{flag.name} = {path}: must end in {' or '.join(suffixes)}", BAD_INPUT)
        if path is not None and not path.parent.is_dir():
            fail(f"{flag.name} = {path}: no such folder: {path.parent}", BAD_INPUT)
        return path

    return checked


ResolutionOption = Annotated[
    float | None, option("METERS", "cell size of a generated map or a picture", WORLD)
]
PeopleOption = Annotated[
    int | None, option("N", "people who walk about in the building (docs/real-sensors.md)", WORLD)
]
LaserOption = Annotated[str | None, option("NAME", f"a laser with its errors: {', '.join(LASERS)}", ROBOTS)]
PoseOption = Annotated[str | None, option("NAME", f"errors of the robots' poses: {', '.join(POSES)}", ROBOTS)]
RadioOption = Annotated[
    str | None, option("NAME", f"a radio preset (bandwidth, frame size, range): {', '.join(PRESETS)}", RADIO)
]
SetOption = Annotated[
    list[str] | None,
    option(
        "KEY=VALUE", "any other setting, as radio.loss=0.1 or polygons.lazy=false; repeatable", RUN, "--set"
    ),
]
ViewFlag = Annotated[bool, switch("--view", "view the run live, in a window or on a web page", VIEW)]
ViewAsOption = Annotated[
    str | None, option("native|web|file", "type of viewer; file: only record", VIEW, "--view-as")
]
ShareFlag = Annotated[
    bool,
    switch("--share", "serve the page on the local network, for others to watch (docs/dashboard.md)", VIEW),
]
WaitFlag = Annotated[
    bool, switch("--wait-for-viewer", "start when a viewer has opened the page, not before", VIEW)
]
KeepServingFlag = Annotated[
    bool,
    switch("--keep-serving", "keep the page open after the run until Ctrl-C; default at a terminal", VIEW),
]
SpeedOption = Annotated[float | None, option("STEPS_PER_S", "maximum speed, for viewing", VIEW)]
PicturesFlag = Annotated[bool, switch("--pictures", "draw the maps over time and the channel load", VIEW)]
ScenarioFile = Annotated[
    Path | None, typer.Argument(metavar="SCENARIO.toml", help="a scenario file; flags override it")
]
OutOption = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="run directory (default: a new one under runs/)")
]
JsonFlag = Annotated[bool, typer.Option("--json", help="print the results as JSON and nothing else")]
ViewAs = Annotated[
    str,
    typer.Option(
        metavar="native|web|file", help="type of viewer (default: a window, or a web page without a display)"
    ),
]
FIGURE_FLAGS = (
    (
        "formats",
        Annotated[
            str,
            option("pdf,svg,csv,tex", "also write figures as PDF or SVG, tables as CSV or LaTeX", FIGURES),
        ],
        "",
    ),
    (
        "figure_width",
        Annotated[float | None, option("CM", "width of each figure (default: 11 cm per panel)", FIGURES)],
        None,
    ),
    ("font", Annotated[str | None, option("NAME", "font of figures, as serif or Arial", FIGURES)], None),
    ("font_size", Annotated[float, option("POINTS", "size of all text in figures", FIGURES)], 10.0),
)
"""The flags of all commands that write figures and tables: name, annotation, default."""


class Subcommands(TyperGroup):
    """A command with subcommands; its help lists the first sentence of each in full."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the list of subcommands."""
        with formatter.section("Commands"):
            commands = [(name, self.commands[name]) for name in self.list_commands(ctx)]
            formatter.write_dl([(name, each.get_short_help_str(sys.maxsize)) for name, each in commands])


class GroupedCommand(TyperCommand):
    """A command whose help lists flags by group, as plain text; typer itself groups flags only in Rich boxes."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the flags of each group under its name, in the order in which groups first occur."""
        groups: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None:
                group = getattr(parameter, "rich_help_panel", None) or "Options"
                groups.setdefault(group, []).append(record)
        for group, records in groups.items():
            with formatter.section(group):
                formatter.write_dl(records)


def position(text: str, flag: str = "start") -> tuple[float, float]:
    """Parse a position, X,Y in meters; ValueError if it is malformed."""
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"{flag} = {text!r}: must be two numbers in meters, as 3.5,12") from None
    return x, y


def duration_s(text: str) -> float:
    """Parse a duration, as 200ms or 1.5s, in seconds; ValueError if it is malformed."""
    parts = re.fullmatch(r"([0-9]*\.?[0-9]+) ?(ms|s)", text.strip())
    if parts is None:
        raise ValueError(f"step = {text!r}: must be a duration, as 200ms or 1.5s")
    return float(parts[1]) / 1000 if parts[2] == "ms" else float(parts[1])


def named_values(texts: list[str], flag: str, example: str) -> dict[str, Any]:
    """Parse NAME=VALUE texts of a flag, values as JSON where possible; ValueError if a text is malformed."""
    values: dict[str, Any] = {}
    for text in texts:
        name, sign, value = text.partition("=")
        if not sign or not name:
            raise ValueError(f"{flag} = {text!r}: must be NAME=VALUE, as {example}")
        if name in values:
            raise ValueError(f"{flag} = {text!r}: {name} is given twice")
        try:
            values[name] = json.loads(value)
        except RecursionError:
            raise ValueError(f"{flag} = '{name}=...': nested too deeply") from None
        except ValueError:
            values[name] = value
    return values
