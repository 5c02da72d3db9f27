"""The command line: `murmur` and its commands."""

from __future__ import annotations

import json
import os
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from agent.exchange.polygon import THESIS_OPTIONS
from agent.strategies.catalogue import COMBINING, catalogue, entry
from deploy.commands.by_hand import run_app
from deploy.commands.console import (
    PAPER_WIDTH,
    errors,
    explain_difference,
    fail,
    progress,
    report_deaths,
    report_result,
    screen,
    speaking_clearly,
)
from deploy.commands.flags import (
    JsonFlag,
    OutOption,
    ScenarioFile,
    ViewAs,
    default,
    named_values,
    pair,
    preformatted,
    setting,
)
from deploy.scenario.scenario import Scenario, ScenarioError, load

app = typer.Typer(
    name="murmur",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="""Robot swarms that map a building together over a radio of a kilobyte a second.

    \b
    Begin with:  murmur explore --robots 5        (an office, seen and shared by five robots)
    then look at the picture that it names, and at:  murmur map list,  murmur strategies,  murmur doctor

    Exit codes: 0 explored, 1 not finished (or a replay that does not hold), 2 bad input, 3 a process died
    or the disk is full.""",
)
maps_app = typer.Typer(no_args_is_help=True, help="List, make and show maps.")
app.add_typer(maps_app, name="map")
app.add_typer(run_app, name="run")


@app.command()
def explore(
    scenario: ScenarioFile = None,
    map: setting("map", str, "FILE.yaml|NAME") = None,  # type: ignore[valid-type]
    robots: setting("robots", int, "N") = None,  # type: ignore[valid-type]
    range: setting("range", str, "METRES|P%") = None,  # type: ignore[valid-type]
    bandwidth: setting("bandwidth", str, "BYTES|unlimited") = None,  # type: ignore[valid-type]
    exchange: setting("exchange", str, "NAME") = None,  # type: ignore[valid-type]
    strategy: setting("strategy", str, "NAME") = None,  # type: ignore[valid-type]
    sensor_range: setting("sensor_range", float, "M") = None,  # type: ignore[valid-type]
    speed: setting("speed", float, "M_PER_STEP") = None,  # type: ignore[valid-type]
    seed: setting("seed", int, "S") = None,  # type: ignore[valid-type]
    map_seed: setting("map_seed", int, "S") = None,  # type: ignore[valid-type]
    start: Annotated[str | None, typer.Option(metavar="X,Y", help=default("start"))] = None,
    offers: setting("offers", str, "NAME") = None,  # type: ignore[valid-type]
    thesis: Annotated[
        bool, typer.Option("--thesis", help="the thesis' plain rules of offering, refining and drawing")
    ] = False,
    option: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="an option of the strategy (murmur strategies); repeatable"),
    ] = None,
    bus: setting("bus", str, "zenoh|memory") = None,  # type: ignore[valid-type]
    steps: setting("steps", int, "MAX") = None,  # type: ignore[valid-type]
    view: Annotated[
        bool, typer.Option("--view", help="show it live: a window, or a page if there is no display")
    ] = False,
    view_as: Annotated[
        str | None, typer.Option(metavar="native|web|file", help="show it so; file: record only")
    ] = None,
    pace: Annotated[
        float | None, typer.Option(metavar="STEPS_PER_S", help="no faster than this, for watching")
    ] = None,
    pictures: Annotated[
        bool, typer.Option("--pictures", help="draw the maps over time and the channel's load")
    ] = False,
    out: OutOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Explore a building: start a world, a radio relay and N robots as processes, and watch them finish.

    All that comes out is in the run directory: summary.json, steps.parquet, ledger.parquet, maps.png, the
    maps themselves, and scenario.toml, from which `murmur replay` repeats the run.

    A scenario file sets more than the flags do (radius, exchanges, scanner_turn, robots that differ, ...):
    docs/protocol.md lists all settings, and the scenario.toml of any run is one to begin with.
    """
    overrides: dict[str, Any] = {
        "map": map, "robots": robots, "range": range, "bandwidth": bandwidth, "exchange": exchange,
        "strategy": strategy, "sensor_range": sensor_range, "speed": speed, "seed": seed,
        "map_seed": map_seed, "offers": offers, "bus": bus, "steps": steps,
    }  # fmt: skip
    with speaking_clearly():
        if thesis:
            overrides |= {"offers": offers or "thesis", "polygon": asdict(THESIS_OPTIONS)}
        if start is not None:
            overrides["start"] = pair(start)
        if option:
            overrides["options"] = named_values(option, "option", "beta=0.5")
        chosen = load(scenario, overrides)
        show = view_as or ("auto" if view else None)
        raise typer.Exit(_explore(chosen, out, show, pictures=pictures, pace=pace, as_json=as_json))


@app.command()
def watch(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="a run directory")],
    view_as: ViewAs = "auto",
) -> None:
    """Look at a run that is under way, or at the recording of one (docs/dashboard.md)."""
    from deploy.dashboard import watch as watching  # noqa: PLC0415
    from deploy.dashboard.windows import Window  # noqa: PLC0415

    with speaking_clearly():
        window = Window(view_as, errors.print)
        try:
            watching.watch(directory, window)
        finally:
            window.close()


@app.command()
def report(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="a run directory")],
) -> None:
    """Draw a run's maps over time and its traffic, and write one HTML page of it all: report.html."""
    from deploy.after.report import write_report  # noqa: PLC0415

    with speaking_clearly():
        page = write_report(directory, errors.print)
        screen.print(f"{page}: the run on one page, pictures and all")


@app.command()
def export(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="a run directory")],
    mcap: Annotated[
        bool, typer.Option("--mcap", help="a ROS 2 bag in MCAP, for Foxglove and ROS tools")
    ] = False,
) -> None:
    """Write a run in a form that other programs open: poses, scans, maps and polygons."""
    from deploy.after.export import export_mcap  # noqa: PLC0415

    with speaking_clearly():
        if not mcap:
            raise ScenarioError("export: say into what; there is --mcap")
        written = export_mcap(directory, errors.print)
        screen.print(f"{written}: open it in Foxglove, or play {written.parent} with ros2 bag")


@app.command()
def replay(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="a run directory")],
    bus: Annotated[
        str | None, typer.Option(help="on this bus (default: the run's own)", metavar="zenoh|memory")
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """Repeat a run from its directory alone, and check that its digest comes out again."""
    from deploy.after.archive import why_unrepeatable  # noqa: PLC0415
    from deploy.record import run_directory  # noqa: PLC0415
    from deploy.run import exploration  # noqa: PLC0415

    with speaking_clearly():
        scenario = run_directory.read_scenario(directory)
        if bus is not None:
            scenario = load(directory / run_directory.SCENARIO, {"bus": bus})
        before = run_directory.read_summary(directory)
        if reason := why_unrepeatable(before):
            raise ScenarioError(f"{directory}: this run cannot be repeated: {reason}")
        with progress(shown=not as_json) as watch:
            result = exploration.explore(scenario, keep=False, watch=watch)
        report_deaths(result.deaths)
        if result.exit_code == exploration.BROKEN_OFF:
            raise typer.Exit(exploration.BROKEN_OFF)
        same = result.summary["digest"] == before["digest"]
        if as_json:
            print(json.dumps({"holds": same, "digest": result.summary["digest"], "before": before["digest"]}))
        elif same:
            screen.print(f"The run holds: {result.summary['steps']} steps, digest {before['digest'][:16]}…")
        else:
            explain_difference(before, result.summary)
        raise typer.Exit(0 if same else 1)


@app.command("capture")
def show_capture(
    directory: Annotated[
        Path | None, typer.Argument(metavar="DIR", help="a run directory, or its radio.pcapng")
    ] = None,
    robot: Annotated[int | None, typer.Option(min=0, help="only what this robot said or heard")] = None,
    kind: Annotated[str | None, typer.Option(help="only frames with packets of this kind, as em")] = None,
    step: Annotated[str | None, typer.Option(metavar="S|S-T", help="only these steps")] = None,
    refused: Annotated[bool, typer.Option("--refused", help="only what was not carried")] = False,
    packets: Annotated[bool, typer.Option("--packets", help="every packet by name and field")] = False,
    install_dissector: Annotated[
        bool, typer.Option("--install-dissector", help="teach Wireshark and tshark to read radio.pcapng")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="print JSON: all frames with their packets")
    ] = False,
) -> None:
    """Show what was said on the radio of a run, frame by frame, and why what was refused was.

    The same opens in Wireshark: murmur capture --install-dissector, then wireshark DIR/radio.pcapng
    """
    from deploy.after import capture, wireshark  # noqa: PLC0415

    with speaking_clearly():
        if install_dissector:
            screen.print(f"installed: {wireshark.install()}", markup=False)
        elif directory is None:
            raise ValueError("name a run directory, or use --install-dissector")
        if directory is None:
            return
        wanted = capture.Filter(
            capture.check_robot(directory, robot) if robot is not None else None,
            capture.check_kind(kind) if kind is not None else None,
            capture.parse_steps(step) if step is not None else None,
            refused,
        )
        table = capture.lines(directory, wanted, every_packet=packets)
        for line in capture.json_lines(directory, wanted) if as_json else table:
            print(line)


@app.command(
    help=f"List the exploration strategies, or show one with all its options.\n\n\b\n{preformatted(COMBINING)}"
)
def strategies(
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="show this one, or the class package.module:Class")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="print all that is known of them as JSON")] = False,
) -> None:
    """List the exploration strategies, or show one with all its options."""
    from deploy.commands import strategy_pages as pages  # noqa: PLC0415

    with speaking_clearly():
        entries = catalogue() if name is None else [entry(name)]
        if as_json:
            print(json.dumps(pages.for_machines(entries)))
        else:
            pages.console(screen).print(pages.listing(entries) if name is None else pages.page(entries[0]))


@app.command()
def sweep(
    experiment: Annotated[
        Path, typer.Argument(metavar="EXPERIMENT.toml", help="what to run (docs/experiments.md)")
    ],
    jobs: Annotated[int | None, typer.Option(min=1, help="processes (default: one a core)")] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", help="replace a list of the grid or a key of the base; repeatable"
        ),
    ] = None,
    variant: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="run only this variant; repeatable")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.jsonl", help="a summary a line; what is there is not run again"),
    ] = None,
) -> None:
    """Run a scenario over a grid of settings, on the memory bus, and print the table that the file asks for."""
    from concurrent.futures import BrokenExecutor  # noqa: PLC0415

    from deploy.commands.terminal import counting, table  # noqa: PLC0415
    from deploy.study import sweep as sweeps  # noqa: PLC0415
    from deploy.study.tables import tabulate  # noqa: PLC0415

    with speaking_clearly():
        settings = named_values(set_ or [], "set", "seed=[0,1]")
        read = sweeps.override(sweeps.choose(sweeps.read(experiment), variant or []), settings)
        todo = sweeps.cases(read)
        outcomes: list[sweeps.Outcome] = []
        try:
            with counting(errors, read.name, len(todo)) as tell:
                for outcome in sweeps.run(todo, jobs or os.cpu_count() or 1, out):
                    outcomes.append(outcome)
                    tell(len(outcomes), len(todo))
        except KeyboardInterrupt:
            fail("stopped" + (f"; the same command goes on with {out}" if out is not None else ""), 130)
        except BrokenExecutor:
            fail("a process of the sweep died", 3)
        finally:
            done = sweeps.summaries(todo, outcomes)
            if done:
                of = f" of {len(todo)}" if len(done) < len(todo) else ""
                screen.print(f"{read.name}: {' '.join(read.table.values)}, means of {len(done)}{of} runs")
                paper = screen if screen.is_terminal else Console(width=PAPER_WIDTH, highlight=False)
                paper.print(table(tabulate(read.table, done)))


@maps_app.command("list")
def map_list() -> None:
    """List the environments that can be generated; a YAML file of a ROS map does as well."""
    from worldsim import generators  # noqa: PLC0415

    names = generators.names()
    for name in names:
        screen.print(f"[bold]{name:{max(map(len, names))}}[/bold]  {generators.describe(name)}")


@maps_app.command("make")
def map_make(
    name: Annotated[str, typer.Argument(metavar="NAME", help="what `murmur map list` names")],
    seed: Annotated[int, typer.Option(min=0, help="which one of its kind")] = 0,
    out: Annotated[Path | None, typer.Option(metavar="FILE.yaml", help="default: NAME.yaml here")] = None,
) -> None:
    """Make a map and write it as ROS map_server reads it: a YAML file and its picture."""
    from worldsim import generators, maps  # noqa: PLC0415

    with speaking_clearly():
        path = out or Path(f"{name}.yaml")
        if path.suffix not in (".yaml", ".yml"):
            raise ValueError(f"out = {path}: must end in .yaml; the picture is written beside it")
        maps.save(generators.make(name, seed=seed), path)
        screen.print(f"{path}: {generators.describe(name)}, seed {seed}")


@maps_app.command("show")
def map_show(
    file: Annotated[str, typer.Argument(metavar="FILE.yaml|NAME", help="a map file, or a generator's name")],
    seed: Annotated[int, typer.Option(min=0, help="the generator's seed")] = 0,
    png: Annotated[Path | None, typer.Option(metavar="FILE.png", help="draw it there, with metres")] = None,
) -> None:
    """Show a map in the terminal, with its figures."""
    from deploy.commands.terminal import sketch  # noqa: PLC0415
    from deploy.scenario import plan  # noqa: PLC0415

    with speaking_clearly():
        world_map = plan.load_map(load(None, {"map": file, "map_seed": seed}))
        free = int((world_map.cells == 1).sum())
        screen.print(sketch(world_map.cells, screen))
        screen.print(
            f"{world_map.name}: {world_map.width} x {world_map.height} cells of {world_map.resolution:g} m, "
            f"{world_map.width * world_map.resolution:.1f} x {world_map.height * world_map.resolution:.1f} m, "
            f"{free} free cells ({100 * free / world_map.cells.size:.0f} %), "
            f"diagonal {world_map.diagonal_m:.1f} m"
        )
        if png is not None:
            from deploy.record.map_pictures import draw_map  # noqa: PLC0415

            draw_map(png, world_map)
            screen.print(f"drawn to {png}")


@app.command()
def doctor() -> None:
    """Check that this installation works: versions, compiled kernels, the bus on loopback, a tiny swarm."""
    from deploy.commands.doctor import examine  # noqa: PLC0415

    raise typer.Exit(0 if examine(screen) else 1)


@app.command()
def bench(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="NAME", help="kernels, bus, swarm, replanning, relay, scale; default: all"),
    ] = None,
    robots: Annotated[
        list[int] | None, typer.Option(min=1, max=256, help="sizes of the teams of scale, one each time")
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """Measure this machine: each figure as a ratio against a yardstick taken in the same run."""
    from deploy.bench import run_benches  # noqa: PLC0415

    with speaking_clearly():
        figures = run_benches(names or [], (lambda _: None) if as_json else screen.print, robots or [])
        if as_json:
            print(json.dumps(figures, indent=2))


def _explore(
    scenario: Scenario,
    out: Path | None,
    show: str | None,
    *,
    pictures: bool,
    pace: float | None,
    as_json: bool,
) -> int:
    from deploy.dashboard.watch import keep_showing  # noqa: PLC0415
    from deploy.dashboard.windows import Window  # noqa: PLC0415
    from deploy.run import exploration  # noqa: PLC0415

    window = Window(show, errors.print) if show else None
    try:
        with progress(shown=not as_json) as watch:
            result = exploration.explore(
                scenario,
                out=out,
                watch=watch,
                tell=errors.print,
                window=window,
                pictures=pictures,
                pace=pace,
            )
        code = report_result(result, as_json=as_json)
        if window is not None and result.directory is not None and sys.stdout.isatty():
            keep_showing(result.directory, window)
    finally:
        if window is not None:
            window.close()
    return code


def main() -> None:
    """Entry point of the `murmur` command."""
    app()


if __name__ == "__main__":
    main()
