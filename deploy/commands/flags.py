"""Flags shared by several commands, their help texts, and the parsing of their values."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup


def family() -> typer.Typer:
    """The commands of one file, for `deploy.commands.main` to find by name."""
    return typer.Typer(rich_markup_mode=None)


def default(name: str) -> str:
    """Help text of a scenario setting: what it is, and its default."""
    from deploy.scenario.scenario import Scenario  # noqa: PLC0415  not all commands have settings

    info = Scenario.model_fields[name]
    has_one = info.default is not None and info.default_factory is None
    return f"{info.description}" + (f" (default {info.default})" if has_one else "")


def preformatted(text: str) -> str:
    """Text whose line breaks help keeps."""
    return text.replace("\n\n", "\n\n\b\n")


def to_be_written(*suffixes: str) -> Callable[[Path | None], Path | None]:
    """The check of a flag that names a file to be written: how it ends, and that its folder is there."""

    def checked(path: Path | None) -> Path | None:
        if path is not None and path.suffix not in suffixes:
            raise typer.BadParameter(f"{path} must end in {' or '.join(suffixes)}")
        if path is not None and not path.parent.is_dir():
            raise typer.BadParameter(f"{path}: there is no folder {path.parent}")
        return path

    return checked


ScenarioFile = Annotated[
    Path | None, typer.Argument(metavar="SCENARIO.toml", help="a scenario file; flags override it")
]
OutOption = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="run directory (default: a new one under runs/)")
]
JsonFlag = Annotated[bool, typer.Option("--json", help="print the results as JSON and nothing else")]
ViewAs = Annotated[
    str,
    typer.Option(metavar="native|web|file", help="how to show it; auto: a window if there is a display"),
]


def setting(name: str, kind: Any, metavar: str, group: str) -> Any:
    """A flag that overrides a setting of the scenario, in a group of the help."""
    flag = "--" + name.replace("_", "-")
    return Annotated[
        kind | None, typer.Option(flag, help=default(name), metavar=metavar, rich_help_panel=group)
    ]


class Subcommands(TyperGroup):
    """A command of commands, whose help says the first sentence of each to its end."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the list for help; what is longer than a line goes on in the next."""
        with formatter.section("Commands"):
            whole = [(name, self.commands[name]) for name in self.list_commands(ctx)]
            formatter.write_dl([(name, each.get_short_help_str(sys.maxsize)) for name, each in whole])


class GroupedCommand(TyperCommand):
    """A command with so many flags that its help shows them in groups."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the flags of each group under its name, in the order in which groups come first."""
        groups: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None:
                group = getattr(parameter, "rich_help_panel", None) or "Options"
                groups.setdefault(group, []).append(record)
        for group, records in groups.items():
            with formatter.section(group):
                formatter.write_dl(records)


def pair(text: str) -> tuple[float, float]:
    """Parse a position, X,Y in metres; ValueError if it is malformed."""
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"start = {text!r}: must be two numbers of metres, as 3.5,12") from None
    return x, y


def named_values(texts: list[str], flag: str, example: str) -> dict[str, Any]:
    """Parse NAME=VALUE texts of a flag, values as JSON where possible; ValueError says what is wrong."""
    values: dict[str, Any] = {}
    for text in texts:
        name, sign, value = text.partition("=")
        if not sign or not name:
            raise ValueError(f"{flag} = {text!r}: must be NAME=VALUE, as {example}")
        if name in values:
            raise ValueError(f"{flag} = {text!r}: {name} is given twice; give it once, as {example}")
        try:
            values[name] = json.loads(value)
        except RecursionError:
            raise ValueError(f"{flag} = '{name}=...': is nested too deeply") from None
        except ValueError:
            values[name] = value
    return values
