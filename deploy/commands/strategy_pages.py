"""What `murmur strategies` prints: all strategies, paper by paper, or one with all its options."""

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
"""Maximum columns; a narrower terminal is used fully."""


def console(terminal: Console) -> Console:
    """A console like `terminal` for pages of at most `WIDTH` columns."""
    width = min(WIDTH, terminal.width) if terminal.is_terminal else WIDTH
    return Console(file=terminal.file, width=width, highlight=False, markup=False)


def listing(entries: list[Entry]) -> RenderableType:
    """All strategies, paper by paper: the name, where the paper describes it, and what it does."""
    lines = []
    for paper, group in groupby(sorted(entries, key=lambda entry: (entry.paper, entry.name)), _paper):
        lines.append(Text(paper))
        for entry in group:
            lines.append(Text.assemble("  ", (entry.name, "bold"), f"  {entry.section}"))
            lines.append(Text(f"      {entry.summary}"))
        lines.append(Text(""))
    default = Scenario.model_fields["strategy"].default
    lines.append(Text(f"The default is {default}. One with all its options: murmur strategies NAME"))
    lines.append(Text("How parts combine: murmur strategies --help"))
    return Group(*lines)


def page(entry: Entry, called: str) -> RenderableType:
    """One strategy: what it does, its options with defaults and choices, and those that it does not accept.

    `called` is the name by which it was asked for, which runs it as well.
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
            what = option.help + (f": {', '.join(option.choices)}" if option.choices else "")
            bound = "" if option.least is None else f" (at least {option.least:g})"
            table.add_row(option.name, _shown(option.default), what + bound)
        lines += [table, Text("")]
    for reason, names in _by_reason(entry):
        lines.append(Text(f"It takes no {', '.join(names)}: {reason}."))
    lines += [Text(f"{clash}.") for clash in entry.clashes]
    lines.append(Text(f"\nmurmur explore --strategy {called} --option NAME=VALUE"))
    return Group(*lines)


def for_machines(entries: list[Entry]) -> dict[str, Any]:
    """All data of strategies, by name."""
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
