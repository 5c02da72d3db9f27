"""`murmur explore` and `murmur watch`: run a swarm, and view one."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from deploy.commands.console import errors, progress, report_result, report_user_errors
from deploy.commands.flags import (
    GroupedCommand,
    JsonFlag,
    OutOption,
    ScenarioFile,
    ViewAs,
    default,
    family,
    named_values,
    pair,
    setting,
)
from deploy.scenario.scenario import Scenario, load
from deploy.scenario.thesis import load_by_thesis
from netshaper.presets import PRESETS

app = family()

WORLD, ROBOTS, RADIO, RUN, SHOW = "The world", "The robots", "The radio", "The run", "What is shown of it"
"""Groups of flags."""


@app.command(cls=GroupedCommand)
def explore(
    scenario: ScenarioFile = None,
    map: setting("map", str, "FILE|NAME", WORLD) = None,  # type: ignore[valid-type]
    map_seed: setting("map_seed", int, "S", WORLD) = None,  # type: ignore[valid-type]
    resolution: Annotated[
        float | None,
        typer.Option(
            metavar="M", help="metres a cell, of a generated map or a picture", rich_help_panel=WORLD
        ),
    ] = None,
    start: Annotated[
        str | None, typer.Option(metavar="X,Y", help=default("start"), rich_help_panel=WORLD)
    ] = None,
    robots: setting("robots", int, "N", ROBOTS) = None,  # type: ignore[valid-type]
    strategy: setting("strategy", str, "NAME", ROBOTS) = None,  # type: ignore[valid-type]
    option: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE",
            help="an option of the strategy (murmur strategies NAME); repeatable",
            rich_help_panel=ROBOTS,
        ),
    ] = None,
    sensor_range: setting("sensor_range", float, "M", ROBOTS) = None,  # type: ignore[valid-type]
    speed: setting("speed", float, "M_PER_STEP", ROBOTS) = None,  # type: ignore[valid-type]
    range: setting("range", str, "METRES|P%", RADIO) = None,  # type: ignore[valid-type]
    bandwidth: setting("bandwidth", str, "BYTES|unlimited", RADIO) = None,  # type: ignore[valid-type]
    radio: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help=f"a radio's bandwidth, frames and range by name: {', '.join(PRESETS)}",
            rich_help_panel=RADIO,
        ),
    ] = None,
    map_encoding: setting("map_encoding", str, "NAME", RADIO) = None,  # type: ignore[valid-type]
    dissemination: setting("dissemination", str, "NAME", RADIO) = None,  # type: ignore[valid-type]
    thesis: Annotated[
        bool,
        typer.Option(
            "--thesis",
            help="the thesis' plain rules: its outlines, and its ways to offer, refine, draw and choose",
            rich_help_panel=RADIO,
        ),
    ] = False,
    seed: setting("seed", int, "S", RUN) = None,  # type: ignore[valid-type]
    steps: setting("steps", int, "MAX", RUN) = None,  # type: ignore[valid-type]
    bus: setting("bus", str, "zenoh|memory", RUN) = None,  # type: ignore[valid-type]
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="any other setting of a scenario, as radius=0.2 or polygons.lazy=false; repeatable",
            rich_help_panel=RUN,
        ),
    ] = None,
    view: Annotated[
        bool,
        typer.Option(
            "--view", help="show it live: a window, or a page if there is no display", rich_help_panel=SHOW
        ),
    ] = False,
    view_as: Annotated[
        str | None,
        typer.Option(metavar="native|web|file", help="show it so; file: record only", rich_help_panel=SHOW),
    ] = None,
    pace: Annotated[
        float | None,
        typer.Option(metavar="STEPS_PER_S", help="no faster than this, for watching", rich_help_panel=SHOW),
    ] = None,
    pictures: Annotated[
        bool,
        typer.Option(
            "--pictures", help="draw the maps over time and the channel's load", rich_help_panel=SHOW
        ),
    ] = False,
    hosts: Annotated[
        Path | None, typer.Option(metavar="HOSTS.toml", help="run robots on other hosts too (docs/hosts.md)")
    ] = None,
    restart: Annotated[
        bool,
        typer.Option(
            "--restart", help="start what dies again, and go on (docs/reliability.md)", rich_help_panel=RUN
        ),
    ] = False,
    out: OutOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Explore a building: start a world, a radio relay and N robots as processes, and watch them finish.

    All results are in the run directory: summary.json, steps.parquet, ledger.parquet, maps.png, the
    maps themselves, and scenario.toml, from which `murmur replay` repeats the run.

    docs/settings.md lists all settings, which --set takes as well; the scenario.toml of any run is one to
    begin with.
    """
    overrides: dict[str, Any] = {
        "map": map, "robots": robots, "range": range, "bandwidth": bandwidth, "map_encoding": map_encoding,
        "strategy": strategy, "sensor_range": sensor_range, "speed": speed, "seed": seed,
        "map_seed": map_seed, "dissemination": dissemination, "bus": bus, "steps": steps,
    }  # fmt: skip
    with report_user_errors():
        if set_:
            overrides |= _other_settings(set_, overrides)
        overrides["radio.preset"] = radio
        if resolution is not None:
            overrides["map_options.resolution"] = resolution
        if start is not None:
            overrides["start"] = pair(start)
        if option:
            overrides["options"] = named_values(option, "option", "beta=0.5")
        chosen = (load_by_thesis if thesis else load)(scenario, overrides)
        show = view_as or ("auto" if view else None)
        code = _explore(
            chosen, out, show, hosts, pictures=pictures, pace=pace, restart=restart, as_json=as_json
        )
        raise typer.Exit(code)


@app.command()
def watch(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="a run directory")],
    view_as: ViewAs = "auto",
) -> None:
    """View a run in progress, or the recording of one (docs/dashboard.md)."""
    from deploy.dashboard import watch as watching  # noqa: PLC0415
    from deploy.dashboard.windows import Window  # noqa: PLC0415
    from deploy.run.interrupt import sigterm_as_ctrl_c  # noqa: PLC0415

    with report_user_errors(), sigterm_as_ctrl_c():
        window = Window(view_as, errors.print)
        try:
            watching.watch(directory, window)
        finally:
            window.close()


def _other_settings(texts: list[str], flags: dict[str, Any]) -> dict[str, Any]:
    """The settings that --set names; ValueError if a flag sets one of them too."""
    values = named_values(texts, "set", "radius=0.2")
    for name in values:
        if flags.get(name) is not None:
            raise ValueError(
                f"set = '{name}=...': --{name.replace('_', '-')} sets it too; leave it to one of them"
            )
    return values


def _explore(
    scenario: Scenario,
    out: Path | None,
    show: str | None,
    hosts: Path | None,
    *,
    pictures: bool,
    pace: float | None,
    restart: bool,
    as_json: bool,
) -> int:
    from deploy.commands.live_keys import controlled, is_at_terminal  # noqa: PLC0415
    from deploy.dashboard.watch import keep_showing  # noqa: PLC0415
    from deploy.dashboard.windows import Window  # noqa: PLC0415
    from deploy.run import exploration  # noqa: PLC0415
    from deploy.run.control import Control  # noqa: PLC0415
    from deploy.run.hosts import load as load_hosts  # noqa: PLC0415
    from deploy.run.interrupt import sigterm_as_ctrl_c  # noqa: PLC0415

    placed = load_hosts(hosts) if hosts is not None else None
    window = Window(show, errors.print) if show else None
    control = Control() if is_at_terminal() and not as_json else None
    try:
        with controlled(control) as below, progress(shown=not as_json, below=below) as watch:
            result = exploration.explore(
                scenario,
                out=out,
                watch=watch,
                notify=errors.print,
                window=window,
                pace=pace,
                hosts=placed,
                control=control,
                restart=restart,
            )
        if pictures and result.directory is not None and result.records.world:
            _draw(result.directory)
        code = report_result(result, as_json=as_json)
        if window is not None and result.directory is not None and sys.stdout.isatty():
            with sigterm_as_ctrl_c():
                keep_showing(result.directory, window)
    finally:
        if window is not None:
            window.close()
    return code


def _draw(directory: Path) -> None:
    """Draw a run's figures into its directory; Ctrl-C does not interrupt it."""
    from deploy.after import archive, figures  # noqa: PLC0415
    from deploy.record.run_directory import PICTURES  # noqa: PLC0415
    from deploy.run.interrupt import Interrupt  # noqa: PLC0415

    with Interrupt().caught():
        run = archive.read(directory)
        figures.write_figures(run, directory / PICTURES)
