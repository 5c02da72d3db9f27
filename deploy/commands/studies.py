"""Many runs: `murmur sweep`, `reproduce`."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from deploy.commands.console import PAPER_WIDTH, errors, fail, screen, speaking_clearly
from deploy.commands.flags import family, named_values

if TYPE_CHECKING:
    from deploy.study.workers import Workers

app = family()

JobsOption = Annotated[int | None, typer.Option(min=1, help="processes (default: one per core)")]
SchedulerOption = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS", help="run on the workers of a Dask scheduler instead, as tcp://10.0.0.1:8786"
    ),
]
SeedsOption = Annotated[int | None, typer.Option(min=1, metavar="N", help="run the seeds 0 to N - 1")]
RetryFlag = Annotated[bool, typer.Option("--retry", help="run failed runs of the table again")]
AnyCodeFlag = Annotated[
    bool, typer.Option("--any-code", help="take runs of the table that other versions of the code have made")
]


@app.command()
def sweep(
    experiment: Annotated[
        Path, typer.Argument(metavar="EXPERIMENT.toml", help="the experiment's file (docs/experiments.md)")
    ],
    jobs: JobsOption = None,
    scheduler: SchedulerOption = None,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", help="replace a list of the grid or a key of the base; repeatable"
        ),
    ] = None,
    seeds: SeedsOption = None,
    variant: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="run only this variant; repeatable")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="only what the file's [quick] says")] = False,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.parquet", help="the table of runs; those already in it are not repeated"),
    ] = None,
    table: Annotated[
        Path | None, typer.Option(metavar="FILE.csv|.parquet", help="write means, intervals and quartiles")
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(metavar="FILE.png", help="draw the file's plots (FILE-2.png and so on for more)"),
    ] = None,
    retry: RetryFlag = False,
    any_code: AnyCodeFlag = False,
) -> None:
    """Run a scenario over a grid of settings, on the memory bus, and print the table that the file defines."""
    from deploy.commands import terminal  # noqa: PLC0415
    from deploy.study import experiment as experiments  # noqa: PLC0415
    from deploy.study import plots  # noqa: PLC0415
    from deploy.study.results import Results, write_table  # noqa: PLC0415
    from deploy.study.runs import cases, failures, looked_up, make  # noqa: PLC0415
    from deploy.study.tables import described, tabulate  # noqa: PLC0415

    with speaking_clearly():
        settings = named_values(set_ or [], "set", "seed=[0,1]")
        if seeds is not None:
            settings["seed"] = list(range(seeds))
        read = experiments.read(experiment)
        read = experiments.quickened(read) if quick else read
        read = experiments.override(experiments.choose(read, variant or []), settings)
        todo = cases(read)
        with Results(out) as results:
            try:
                with running(read.name, out) as tell:
                    make(todo, results, workers(jobs, scheduler), tell, any_code=any_code, retry=retry)
            finally:
                done = looked_up(todo, results)
                report_failures(failures(todo, results))
                if done:
                    of = f" of {len(todo)}" if len(done) < len(todo) else ""
                    screen.print(f"{read.name}: {' '.join(read.table.values)}, means of {len(done)}{of} runs")
                    print_table(terminal.table(tabulate(read.table, done)))
                    if table is not None:
                        write_table(described(read.table, done), table)
            for number, each in enumerate(read.plots if plot is not None and done else (), 1):
                assert plot is not None
                file = plot if number == 1 else plot.with_stem(f"{plot.stem}-{number}")
                plots.save(plots.draw(each, done, results), file)


@app.command()
def reproduce(
    claim: Annotated[
        list[str] | None, typer.Argument(metavar="CLAIM...", help="as B1 M4 (default: all 24)")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="fewer seeds, smaller grids: a first look")] = False,
    seeds: SeedsOption = None,
    jobs: JobsOption = None,
    scheduler: SchedulerOption = None,
    out: Annotated[
        Path,
        typer.Option(
            metavar="STEM", help="writes STEM.md, STEM.html, and the folder STEM with pictures and tables"
        ),
    ] = Path("reproduction"),
    retry: RetryFlag = False,
    any_code: AnyCodeFlag = False,
) -> None:
    """Run the experiments of the papers, and say of each claim whether it holds here (exit code 1: not all do)."""
    from deploy.commands import terminal  # noqa: PLC0415
    from deploy.study import reproduction  # noqa: PLC0415
    from deploy.study.results import Results  # noqa: PLC0415

    with speaking_clearly():
        settings = {"seed": list(range(seeds))} if seeds is not None else {}
        found = reproduction.asked(claim or [], quick=quick, settings=settings)
        out.mkdir(parents=True, exist_ok=True)
        runs = out / reproduction.RUNS
        with Results(runs) as results:
            with running("reproduce", runs) as tell:
                done = reproduction.reproduce(
                    found,
                    results,
                    workers(jobs, scheduler),
                    tell,
                    quick=quick,
                    any_code=any_code,
                    retry=retry,
                )
            words = ["murmur reproduce", *(claim or []), *(["--quick"] if quick else [])]
            words += [f"--seeds {seeds}"] if seeds is not None else []
            pages = reproduction.write(done, out, " ".join(words))
        lines = [["claim", "", "verdict", "tests", "runs"]]
        for each in done.claims:
            counts = each.verdict.counts
            lines.append([each.claim.id, each.claim.says, each.verdict.word, counts, str(each.runs)])
            for part in each.parts:
                report_failures(part.failures)
        lines += [[name, "", "no experiment", "", "0"] for name in done.unasked]
        print_table(terminal.table(lines))
        screen.print(
            f"Everything is in {' and '.join(map(str, pages))}" + ("; a first look." if quick else ".")
        )
    raise typer.Exit(0 if done.all_hold else 1)


def workers(jobs: int | None, scheduler: str | None) -> Workers:
    """Who makes the runs, by the flags."""
    from deploy.study.workers import Cluster, LocalPool  # noqa: PLC0415

    return LocalPool(jobs or os.cpu_count() or 1) if scheduler is None else Cluster(scheduler)


@contextmanager
def running(name: str, out: Path | None) -> Iterator[Any]:
    """Show the progress of many runs; Ctrl-C says how to go on."""
    from deploy.study.progress import counting  # noqa: PLC0415

    try:
        with counting(errors, name) as tell:
            yield tell
    except KeyboardInterrupt:
        fail("stopped" + (f"; the same command continues from {out}" if out is not None else ""), 130)


def print_table(table: Any) -> None:
    """Print a table as wide as the terminal, or wide enough for a file."""
    paper = screen if screen.is_terminal else Console(width=PAPER_WIDTH, highlight=False)
    paper.print(table)


def report_failures(causes: dict[str, int]) -> None:
    """Print why runs failed."""
    for cause, count in causes.items():
        errors.print(f"{count} run{'s' if count > 1 else ''} failed: {cause}")
