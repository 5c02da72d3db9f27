"""Output of `murmur strategies`: all strategies by paper, or one strategy with all its options."""

from __future__ import annotations

from dataclasses import asdict
from itertools import groupby
from typing import Any

from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from agent.strategies.catalog import Entry
from deploy.scenario.scenario import Scenario

WIDTH = 100
"""Maximum width in columns."""


def console(terminal: Console) -> Console:
    """A console like `terminal` for pages of at most `WIDTH` columns."""
    width = min(WIDTH, terminal.width) if terminal.is_terminal else WIDTH
    return Console(file=terminal.file, width=width, highlight=False, markup=False)


def listing(entries: list[Entry]) -> RenderableType:
    """All strategies by paper: name, section of the paper, and summary."""
    lines = []
    for paper, group in groupby(sorted(entries, key=lambda entry: (entry.paper, entry.name)), _paper):
        lines.append(Text(paper))
        for entry in group:
            lines.append(Text.assemble("  ", (entry.name, "bold"), f"  {entry.section}"))
            lines.append(Text(f"      {entry.summary}"))
        lines.append(Text(""))
    default = Scenario.model_fields["strategy"].default
    lines.append(Text(f"Default: {default}. Options of a strategy: murmur strategies NAME"))
    lines.append(Text("Combinations: murmur strategies --help"))
    return Group(*lines)


def page(entry: Entry, called: str) -> RenderableType:
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
    for reason, names in _by_reason(entry):
        lines.append(Text(f"Not accepted: {', '.join(names)}: {reason}."))
    lines += [Text(f"{clash}.") for clash in entry.clashes]
    lines.append(Text(f"\nmurmur explore --strategy {called} --option NAME=VALUE"))
    return Group(*lines)


def as_json(entries: list[Entry]) -> dict[str, Any]:
    """All data of strategies, by name, for JSON."""
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


def _paper(entry: Entry) -> str:
    return entry.paper


def _shown(value: object) -> str:
    """A value as --option accepts it."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def _by_reason(entry: Entry) -> list[tuple[str, list[str]]]:
    reasons: dict[str, list[str]] = {}
    for name, reason in entry.refused.items():
        reasons.setdefault(reason, []).append(name)
    return list(reasons.items())
