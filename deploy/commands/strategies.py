"""`murmur strategies`: list strategies and their options."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from agent.strategies.catalog import COMBINING, catalog, entry
from deploy.commands import strategy_pages as pages
from deploy.commands.console import report_user_errors, screen
from deploy.commands.flags import command_family, preformatted

app = command_family()


@app.command(
    help=f"List the exploration strategies, or show one with all its options.\n\n\b\n{preformatted(COMBINING)}"
)
def strategies(
    name: Annotated[
        str | None,
        typer.Argument(metavar="NAME", help="the strategy to show, or a class package.module:Class"),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="print all data as JSON")] = False,
) -> None:
    """List the exploration strategies, or show one with all its options."""
    with report_user_errors():
        entries = catalog() if name is None else [entry(name)]
        if as_json:
            print(json.dumps(pages.as_json(entries)))
        else:
            pages.console(screen).print(
                pages.listing(entries) if name is None else pages.page(entries[0], name)
            )
