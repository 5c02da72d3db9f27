"""`murmur explore` and `murmur watch`: run a swarm, and view a run."""

from __future__ import annotations

import sys
from contextlib import closing, nullcontext
from pathlib import Path
from typing import Annotated, Any

import typer

from deploy.commands import flags
from deploy.commands.console import errors, progress, report_result
from deploy.commands.flag_values import named_values
from deploy.commands.flags import argument, command_family, option, switch, view_flags
from deploy.commands.scenario_flags import run_flags
from deploy.commands.viewing import Viewing
from deploy.scenario.scenario import SHIPPED, Scenario, load
from deploy.scenario.thesis import with_thesis
from deploy.scenario.toml_files import read_toml

app = command_family()


@app.command()
@run_flags()
@view_flags
def explore(
    scenario: flags.ScenarioFile = None,
    options: Annotated[
        list[str] | None,
        option(
            "NAME=VALUE",
            "an option of the strategy (murmur strategies NAME lists them); repeatable",
            flags.ROBOTS,
            name="--option",
        ),
    ] = None,
    thesis: Annotated[
        bool,
        switch(
            "--thesis",
            "map encoding, dissemination, and strategy of Meier's thesis (docs/settings.md)",
            flags.RADIO,
        ),
    ] = False,
    restart: Annotated[
        bool, switch("--restart", "restart processes that die, and continue (docs/reliability.md)", flags.RUN)
    ] = False,
    hosts: Annotated[
        Path | None, option("HOSTS.toml", "run robots on other hosts, too (docs/hosts.md)", flags.RUN)
    ] = None,
    pace: flags.SpeedOption = None,
    pictures: flags.PicturesFlag = False,
    out: flags.OutOption = None,
    as_json: flags.JsonFlag = False,
    *,
    settings: dict[str, Any],
    viewing: Viewing,
) -> None:
    """Explore a building: start a world, a radio relay and N robots as processes, and wait until they finish.

    The run directory contains all results: summary.json, tables, pictures, maps, and scenario.toml, from which
    `murmur replay` repeats the run. docs/settings.md lists all settings.
    """
    if options:
        settings["options"] = named_values(options, "option", "beta=0.5")
    if thesis:
        in_file = {} if scenario is None else read_toml(scenario, "scenario", SHIPPED)[1]
        settings = with_thesis(settings, in_file)
    chosen = load(scenario, settings)
    choices = {"out": out, "pace": pace, "restart": restart}
    raise typer.Exit(run_live(chosen, viewing, hosts, choices, pictures=pictures, as_json=as_json))


@app.command()
def watch(
    directory: Annotated[Path, argument("DIR", "a run directory")],
    view_as: flags.ViewAs = "auto",
    share: flags.ShareFlag = False,
) -> None:
    """View a run in progress, or the recording of one (docs/dashboard.md)."""
    from deploy.dashboard import watch as watching  # noqa: PLC0415
    from deploy.dashboard.windows import Window  # noqa: PLC0415
    from deploy.run.interrupt import signals_as_ctrl_c  # noqa: PLC0415

    with signals_as_ctrl_c(), closing(Window(view_as, errors.print, share=share)) as window:
        watching.watch(directory, window)


def run_live(
    scenario: Scenario,
    viewing: Viewing,
    hosts_file: Path | None,
    options: dict[str, Any],
    *,
    pictures: bool,
    as_json: bool,
) -> int:
    """Run a scenario with its progress line, keys and viewer; `options` go to `exploration.explore`."""
    from deploy.commands.live_keys import at_terminal, controlled  # noqa: PLC0415
    from deploy.dashboard.watch import keep_showing  # noqa: PLC0415
    from deploy.run import exploration  # noqa: PLC0415
    from deploy.run.control import Control  # noqa: PLC0415
    from deploy.run.hosts import load as load_hosts  # noqa: PLC0415
    from deploy.run.interrupt import signals_as_ctrl_c  # noqa: PLC0415

    hosts = load_hosts(hosts_file) if hosts_file is not None else None
    control = Control()
    has_keys = at_terminal() and not as_json
    window, commands = viewing.window(control) if viewing.mode is not None else (None, None)
    is_controlled = has_keys or (window is not None and window.mode == "web")
    with closing(window) if window is not None else nullcontext():
        with (
            controlled(control if has_keys else None) as message,
            progress(shown=not as_json, message=message) as watch,
        ):
            result = exploration.explore(
                scenario,
                watch=watch,
                notify=errors.print,
                window=window,
                hosts=hosts,
                control=control if is_controlled else None,
                check=False,
                **options,
            )
        if commands is not None:
            commands.has_ended = True
        if pictures and result.directory is not None and result.records.world:
            _draw(result.directory)
        code = report_result(result, as_json=as_json)
        keeps = sys.stdout.isatty() or viewing.keep
        if window is not None and result.directory is not None and keeps:
            with signals_as_ctrl_c():
                keep_showing(result.directory, window)
    return code


def _draw(directory: Path) -> None:
    """Draw a run's figures into its directory; Ctrl-C does not interrupt it."""
    from deploy.after import archive, figures  # noqa: PLC0415
    from deploy.record.run_directory import PICTURES  # noqa: PLC0415
    from deploy.run.interrupt import Interrupt  # noqa: PLC0415

    with Interrupt().caught():
        figures.write_figures(archive.read(directory), directory / PICTURES)
