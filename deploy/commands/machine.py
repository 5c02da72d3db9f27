"""`murmur doctor` and `murmur bench`: check the installation and measure its speed."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from deploy.commands.console import screen, speaking_clearly
from deploy.commands.flags import JsonFlag, family

app = family()


@app.command()
def doctor() -> None:
    """Check that this installation works: versions, compiled kernels, the bus on loopback, a small swarm."""
    from deploy.commands.doctor import examine  # noqa: PLC0415

    raise typer.Exit(0 if examine(screen) else 1)


@app.command()
def bench(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="NAME", help="kernels, bus, swarm, replanning, relay, scale, link, hub; default: all"
        ),
    ] = None,
    robots: Annotated[
        list[int] | None, typer.Option(min=1, max=256, help="a team size for scale; repeatable")
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """Benchmark this machine: each figure as a ratio against a yardstick measured in the same run."""
    from deploy.bench.ratios import run_benches  # noqa: PLC0415

    with speaking_clearly():
        figures = run_benches(names or [], (lambda _: None) if as_json else screen.print, robots or [])
        if as_json:
            print(json.dumps(figures, indent=2))
