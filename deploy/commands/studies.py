"""Many runs: `murmur sweep`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from deploy.commands.console import PAPER_WIDTH, errors, fail, screen, speaking_clearly
from deploy.commands.flags import family, named_values

app = family()


@app.command()
def sweep(
    experiment: Annotated[
        Path, typer.Argument(metavar="EXPERIMENT.toml", help="the experiment's file (docs/experiments.md)")
    ],
    jobs: Annotated[int | None, typer.Option(min=1, help="processes (default: one per core)")] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", help="replace a list of the grid or a key of the base; repeatable"
        ),
    ] = None,
    seeds: Annotated[int | None, typer.Option(min=1, metavar="N", help="run the seeds 0 to N - 1")] = None,
    variant: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="run only this variant; repeatable")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.jsonl", help="one summary per line; runs already in it are not repeated"),
    ] = None,
) -> None:
    """Run a scenario over a grid of settings, on the memory bus, and print the table that the file defines."""
    from concurrent.futures import BrokenExecutor  # noqa: PLC0415

    from deploy.commands.terminal import counting, table  # noqa: PLC0415
    from deploy.study import experiment as experiments  # noqa: PLC0415
    from deploy.study.runs import Outcome, cases, run, summaries  # noqa: PLC0415
    from deploy.study.tables import tabulate  # noqa: PLC0415

    with speaking_clearly():
        settings = named_values(set_ or [], "set", "seed=[0,1]")
        if seeds is not None:
            settings["seed"] = list(range(seeds))
        chosen = experiments.choose(experiments.read(experiment), variant or [])
        read = experiments.override(chosen, settings)
        todo = cases(read)
        outcomes: list[Outcome] = []
        try:
            with counting(errors, read.name, len(todo)) as tell:
                for outcome in run(todo, jobs or os.cpu_count() or 1, out):
                    outcomes.append(outcome)
                    tell(len(outcomes), len(todo))
        except KeyboardInterrupt:
            fail("stopped" + (f"; the same command continues from {out}" if out is not None else ""), 130)
        except BrokenExecutor:
            fail("a process of the sweep died", 3)
        finally:
            done = summaries(todo, outcomes)
            if done:
                of = f" of {len(todo)}" if len(done) < len(todo) else ""
                screen.print(f"{read.name}: {' '.join(read.table.values)}, means of {len(done)}{of} runs")
                paper = screen if screen.is_terminal else Console(width=PAPER_WIDTH, highlight=False)
                paper.print(table(tabulate(read.table, done)))
