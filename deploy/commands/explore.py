"""`murmur explore` and `murmur watch`: run a swarm, and view a run."""

from __future__ import annotations

import sys
from contextlib import closing, nullcontext
from pathlib import Path
from typing import Annotated, Any

import typer

from deploy.commands import flags
from deploy.commands.console import errors, progress, report_result
from deploy.commands.flags import (
    RADIO,
    ROBOTS,
    RUN,
    GroupedCommand,
    JsonFlag,
    KeepServingFlag,
    LaserOption,
    OutOption,
    PeopleOption,
    PicturesFlag,
    PoseOption,
    RadioOption,
    ResolutionOption,
    ScenarioFile,
    SetOption,
    ShareFlag,
    SpeedOption,
    ViewAs,
    ViewAsOption,
    ViewFlag,
    WaitFlag,
    command_family,
    duration_s,
    named_values,
    setting_flags,
    switch,
)
from deploy.commands.viewing import Viewing
from deploy.scenario.scenario import SHIPPED, Scenario, load, read_toml
from deploy.scenario.thesis import STRATEGY, thesis_settings

app = command_family()

NESTED = {
    "radio.preset": "--radio", "laser.preset": "--laser", "pose.preset": "--pose",
    "map_options.resolution": "--resolution", "people.number": "--people", "step_s": "--step",
}  # fmt: skip
"""Keys of tables, and settings with other units, that have a flag of their own."""

STRATEGY_OPTION = "an option of the strategy (murmur strategies NAME lists them); repeatable"


@app.command(cls=GroupedCommand)
@setting_flags()
def explore(
    scenario: ScenarioFile = None,
    resolution: ResolutionOption = None,
    option: Annotated[list[str] | None, flags.option("NAME=VALUE", STRATEGY_OPTION, ROBOTS)] = None,
    radio: RadioOption = None,
    laser: LaserOption = None,
    pose: PoseOption = None,
    people: PeopleOption = None,
    step: Annotated[
        str | None,
        flags.option("DURATION", "duration of a step with --clock wall, as 200ms (default 1s)", RUN),
    ] = None,
    thesis: Annotated[
        bool, switch("--thesis", "the rules of the thesis, without later additions", RADIO)
    ] = False,
    set_: SetOption = None,
    restart: Annotated[
        bool, switch("--restart", "restart processes that die, and continue (docs/reliability.md)", RUN)
    ] = False,
    hosts: Annotated[
        Path | None, flags.option("HOSTS.toml", "run robots on other hosts, too (docs/hosts.md)", RUN)
    ] = None,
    view: ViewFlag = False,
    view_as: ViewAsOption = None,
    share: ShareFlag = False,
    wait_for_viewer: WaitFlag = False,
    keep_serving: KeepServingFlag = False,
    pace: SpeedOption = None,
    pictures: PicturesFlag = False,
    out: OutOption = None,
    as_json: JsonFlag = False,
    *,
    settings: dict[str, Any],
) -> None:
    """Explore a building: start a world, a radio relay and N robots as processes, and wait until they finish.

    The run directory contains all results: summary.json, tables, pictures, maps, and scenario.toml, from which
    `murmur replay` repeats the run. docs/settings.md lists all settings.
    """
    step_s = duration_s(step) if step is not None else None
    for name, value in zip(NESTED, (radio, laser, pose, resolution, people, step_s), strict=True):
        settings |= {name: value} if value is not None else {}
    overrides = settings | other_settings(set_ or [], settings)
    if option:
        overrides["options"] = named_values(option, "option", "beta=0.5")
    if thesis:
        in_file = {} if scenario is None else read_toml(scenario, "scenario", SHIPPED)[1]
        overrides = {"strategy": in_file.get("strategy", STRATEGY)} | overrides
        overrides |= thesis_settings(overrides)
    chosen = load(scenario, overrides)
    choices = {"out": out, "pace": pace, "restart": restart}
    needs_page = share or wait_for_viewer or keep_serving
    viewing = Viewing(
        view_as or ("web" if needs_page else "auto" if view else None), share, wait_for_viewer, keep_serving
    )
    raise typer.Exit(run_live(chosen, viewing, hosts, choices, pictures=pictures, as_json=as_json))


@app.command()
def watch(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="a run directory")],
    view_as: ViewAs = "auto",
    share: ShareFlag = False,
) -> None:
    """View a run in progress, or the recording of one (docs/dashboard.md)."""
    from deploy.dashboard import watch as watching  # noqa: PLC0415
    from deploy.dashboard.windows import Window  # noqa: PLC0415
    from deploy.run.interrupt import signals_as_ctrl_c  # noqa: PLC0415

    with signals_as_ctrl_c(), closing(Window(view_as, errors.print, share=share)) as window:
        watching.watch(directory, window)


def other_settings(texts: list[str], flags: dict[str, Any]) -> dict[str, Any]:
    """The settings given with --set; ValueError if a flag gives one of them, too."""
    values = named_values(texts, "set", "radius=0.2")
    for name in values.keys() & flags.keys():
        flag = NESTED.get(name, f"--{name.replace('_', '-')}")
        raise ValueError(f"set = '{name}=...': {flag} is given, too; remove one of them")
    return values


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
