"""`murmur strategies`: list all strategies by paper, or show one with all its options."""

from __future__ import annotations

import json
from dataclasses import asdict
from itertools import groupby
from typing import Annotated, Any

from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from agent.strategies.catalog import COMBINING, Entry, catalog, entry
from deploy.commands.console import screen
from deploy.commands.flags import argument, command_family, switch
from deploy.scenario.scenario import Scenario

app = command_family()

HELP = f"List the exploration strategies, or show one with all its options.\n\n{COMBINING}".replace(
    "\n\n", "\n\n\b\n"
)
"""The help text; click keeps the line breaks of paragraphs after ``\\b``."""

WIDTH = 100
"""Maximum width of the output in columns."""


@app.command(help=HELP)
def strategies(
    name: Annotated[
        str | None, argument("NAME", "the strategy to show, or a class package.module:Class")
    ] = None,
    as_json: Annotated[bool, switch("--json", "print all data as JSON")] = False,
) -> None:
    """List the exploration strategies, or show one with all its options."""
    entries = catalog() if name is None else [entry(name)]
    if as_json:
        print(json.dumps(_as_json(entries)))
        return
    width = min(WIDTH, screen.width) if screen.is_terminal else WIDTH
    console = Console(file=screen.file, width=width, highlight=False, markup=False)
    console.print(_listing(entries) if name is None else _page(entries[0], name))


def _listing(entries: list[Entry]) -> RenderableType:
    """All strategies by paper: name, section of the paper, and summary."""
    lines = []
    for paper, group in groupby(
        sorted(entries, key=lambda each: (each.paper, each.name)), lambda each: each.paper
    ):
        lines.append(Text(paper))
        for each in group:
            lines.append(Text.assemble("  ", (each.name, "bold"), f"  {each.section}"))
            lines.append(Text(f"      {each.summary}"))
        lines.append(Text(""))
    default = Scenario.model_fields["strategy"].default
    lines.append(Text(f"Default: {default}. Options of a strategy: murmur strategies NAME"))
    lines.append(Text("Combinations: murmur strategies --help"))
    return Group(*lines)


def _page(entry: Entry, called: str) -> RenderableType:
    """One strategy: its summary, its options with defaults and choices, and the options that it does not accept.

    `called` is the name that the user gave, which `murmur explore` accepts as well.
    """
    lines: list[RenderableType] = [
        Text.assemble((entry.name, "bold"), f": {entry.summary}"),
        Text(f"{entry.source}\n"),
    ]
    if entry.options:
        table = Table.grid(padding=(0, 2))
        table.add_column("option", style="bold", no_wrap=True)
        table.add_column("default", no_wrap=True)
        table.add_column()
        table.show_header = True
        for option in entry.options:
            description = option.help + (f": {', '.join(option.choices)}" if option.choices else "")
            bound = "" if option.least is None else f" (at least {option.least:g})"
            table.add_row(option.name, _shown(option.default), description + bound)
        lines += [table, Text("")]
    for reason in dict.fromkeys(entry.refused.values()):
        names = [name for name, why in entry.refused.items() if why == reason]
        lines.append(Text(f"Not accepted: {', '.join(names)}: {reason}."))
    lines += [Text(f"{clash}.") for clash in entry.clashes]
    lines.append(Text(f"\nmurmur explore --strategy {called} --option NAME=VALUE"))
    return Group(*lines)


def _as_json(entries: list[Entry]) -> dict[str, Any]:
    return {
        entry.name: {
            "summary": entry.summary,
            "source": entry.source,
            "options": [asdict(option) for option in entry.options],
            "refused": dict(entry.refused),
            "clashes": entry.clashes,
        }
        for entry in entries
    }


def _shown(value: object) -> str:
    """A value as --option accepts it."""
    return str(value).lower() if isinstance(value, bool) else str(value)
