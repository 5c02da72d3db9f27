"""Commands on a finished run: `murmur report`, `export`, `movie`, `replay` and `capture`."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from deploy.commands.console import errors, explain_difference, progress, report_deaths, screen
from deploy.commands.flags import JsonFlag, argument, command_family, option, switch
from deploy.record.number_texts import counted
from deploy.run.exit_codes import BROKEN_OFF
from deploy.scenario import plugins
from deploy.scenario.errors import ScenarioError
from deploy.scenario.scenario import Scenario, load

app = command_family()


@app.command()
def report(
    directories: Annotated[list[Path], argument("DIR [OTHER]", "a run directory, or two to compare")],
    out: Annotated[
        Path | None, option("FILE", "the page (default: report.html in DIR, or compared-with-OTHER.html)")
    ] = None,
) -> None:
    """Write an HTML page of a run, with pictures and a slider; or compare two runs.

    The page is self-contained. Without --out, the pictures of a run are also written to DIR/pictures.
    """
    from deploy.after.report import write_report  # noqa: PLC0415

    directory, *others = directories
    if len(others) > 1:
        raise ValueError("report takes one run directory, or two")
    page = write_report(directory, others[0] if others else None, out)
    screen.print(f"{page}: report of the {'runs' if others else 'run'}")


@app.command()
def export(
    directory: Annotated[Path, argument("DIR", "a run directory")],
    mcap: Annotated[bool, switch("--mcap", "a ROS 2 bag in MCAP, for RViz, Foxglove and ROS tools")] = False,
) -> None:
    """Export poses, scans, maps, outlines and radio traffic of a run to formats of other programs."""
    from deploy.after.export import export_mcap  # noqa: PLC0415

    if not mcap:
        raise ScenarioError("no format given; use --mcap")
    written = export_mcap(directory)
    screen.print(f"{written}: for RViz and Foxglove, or ros2 bag play {shlex.quote(str(written.parent))}")


@app.command()
def movie(
    directories: Annotated[
        list[Path], argument("DIR [OTHER]", "a run directory, or two to show side by side")
    ],
    mp4: Annotated[bool, switch("--mp4", "write an MP4 (default)")] = False,
    gif: Annotated[bool, switch("--gif", "write a GIF")] = False,
    rate: Annotated[float, option("STEPS_PER_S", "speed of the film")] = 10.0,
    out: Annotated[Path | None, option("FILE", "the file (default: movie.mp4 or .gif in DIR)")] = None,
) -> None:
    """Film a run, step by step, or two side by side.

    Each picture shows the building with the robots, the map of each, and the use of the radio.
    """
    from deploy.after.movie import GIF, MP4, write_movie  # noqa: PLC0415
    from deploy.study.progress import counting  # noqa: PLC0415

    if len(directories) > 2:
        raise ValueError("movie takes one run directory, or two")
    if mp4 and gif:
        raise ValueError("use either --mp4 or --gif")
    with counting(errors, "pictures") as progress:
        path = write_movie(directories, GIF if gif else MP4, out, rate=rate, progress=progress)
    screen.print(f"{path}: {path.stat().st_size / 1e6:.1f} MB")


@app.command()
def replay(
    directory: Annotated[Path, argument("DIR", "a run directory")],
    bus: Annotated[str | None, option("zenoh|memory", "bus to use (default: the run's own)")] = None,
    trust: Annotated[
        bool, switch("--trust", "run a strategy or map encoding that is not of an installed package")
    ] = False,
    as_json: JsonFlag = False,
) -> None:
    """Repeat a run from its directory, and check that its digest is the same.

    A run by the wall clock is repeated on the memory bus: the robots miss the same phases of its steps.
    """
    from deploy.record import missed_phases, run_directory  # noqa: PLC0415
    from deploy.record.summary import digest  # noqa: PLC0415
    from deploy.run import control, exploration  # noqa: PLC0415

    recorded = run_directory.read_scenario(directory, bus=bus)
    before = run_directory.read_summary(directory)
    if reason := control.why_unrepeatable(before):
        raise ScenarioError(f"{directory}: cannot be repeated: {reason}")
    run_directory.check_inputs(directory, before)
    if not trust:
        _confirm_local_code(directory, recorded)
    missed = None
    if recorded.clock == "wall":
        if bus == "zenoh":
            raise ValueError(
                "bus = 'zenoh': a run by the wall clock is repeated on the memory bus; omit --bus"
            )
        bus, missed = "memory", missed_phases.read(directory / missed_phases.MISSED, recorded.robots)
    scenario = load(directory / run_directory.SCENARIO, {"bus": bus})
    with progress(shown=not as_json) as watch:
        result = exploration.explore(scenario, keep=False, watch=watch, missed=missed, check=False)
    report_deaths(result.deaths)
    if result.exit_code == BROKEN_OFF:
        raise typer.Exit(BROKEN_OFF)
    now = digest(result.records, without=control.maps_not_sent(before))
    same = now == before["digest"]
    if as_json:
        print(json.dumps({"holds": same, "digest": now, "before": before["digest"]}))
    elif same:
        screen.print(
            f"Replay matches: {counted(result.summary['steps'], 'step')}, digest {before['digest'][:16]}…"
        )
    else:
        explain_difference(before, result.summary)
        for name in run_directory.changed_inputs(directory, before):
            errors.print(f"  {directory / name} has changed since the run")
        for part in plugins.named(scenario):
            if part.name not in part.plugins.built_in:
                errors.print(f"  {part.name} may have changed since, draw random numbers, or read a clock")
    raise typer.Exit(0 if same else 1)


def _confirm_local_code(directory: Path, scenario: Scenario) -> None:
    """Ask at a terminal whether to run code that the scenario names outside the installed packages, else refuse."""
    codes = [part.plugins.local_code(part.name) for part in plugins.named(scenario)]
    for code in filter(None, dict.fromkeys(codes)):
        if not (sys.stdin.isatty() and sys.stderr.isatty()):
            raise ScenarioError(
                f"{directory}: would run {code}, which is no installed package: read it, then use --trust"
            )
        typer.confirm(
            f"{directory} runs {code}, which is no installed package. Run it?", abort=True, err=True
        )


@app.command("capture")
def show_capture(
    directory: Annotated[Path | None, argument("DIR", "a run directory, or its radio.pcapng")] = None,
    robot: Annotated[int | None, option("N", "only frames that this robot sent or received", min=0)] = None,
    kind: Annotated[
        str | None, option("KIND", "only frames with packets of this kind, such as update")
    ] = None,
    step: Annotated[str | None, option("S|S-T", "only these steps")] = None,
    refused: Annotated[bool, switch("--refused", "only refused or lost frames")] = False,
    packets: Annotated[bool, switch("--packets", "list every packet with its bytes and fields")] = False,
    install_dissector: Annotated[
        bool, switch("--install-dissector", "install the Wireshark and tshark dissector of radio.pcapng")
    ] = False,
    as_json: Annotated[bool, switch("--json", "print JSON: all frames with their packets")] = False,
) -> None:
    """Show the radio traffic of a run, frame by frame, with the verdict on each frame.

    To open it in Wireshark: murmur capture --install-dissector, then wireshark DIR/radio.pcapng
    """
    from deploy.after import capture  # noqa: PLC0415
    from deploy.after.wireshark.install import install  # noqa: PLC0415

    if install_dissector:
        screen.print(f"installed: {install()}")
    if directory is None:
        if not install_dissector:
            raise ValueError("name a run directory, or use --install-dissector")
        return
    steps = capture.parse_steps(step) if step is not None else None
    wanted = capture.Filter(robot, kind, steps, refused)
    wanted.check(directory)
    table = capture.lines(directory, wanted, every_packet=packets)
    for line in capture.json_lines(directory, wanted) if as_json else table:
        print(line)


@app.command()
def merge(
    directories: Annotated[
        list[Path], argument("DIR...", "the record directory of each robot, or those of single starts in it")
    ],
    out: Annotated[Path, option("DIR", "the new run directory")],
    view: Annotated[bool, switch("--view", "also write the recording that murmur watch shows")] = False,
) -> None:
    """Join what robots in the field recorded into one run directory, on one clock.

    It has the files of any run, for murmur report, movie, capture, export, and watch. There is no true map: the map in
    it is the one that the team has made, and figures that need a true one are null.
    """
    from deploy.after import merge as merging  # noqa: PLC0415

    summary = merging.merge(directories, out, view=view).summary
    error_s = summary["clock_error_s"]
    bound = "by the time of day, or by frames in one direction only"
    if error_s is not None:
        bound = f"within {1000 * error_s:.1f} ms"
    screen.print(
        f"{out}: {counted(summary['robots'], 'robot')}, {counted(summary['steps'], 'step')} of "
        f"{summary['step_s']:g} s; {counted(summary['frames'], 'frame')}, {summary['frames_lost']} of which no robot "
        f"recorded as received; clocks agree {bound}"
    )
    if not summary["finished"]:
        screen.print(f"not finished: {summary['reason']}")
    for robot, cause in summary["lost"].items():
        screen.print(f"robot {robot}: {cause}")
    if summary["robots"] > 1 and (alone := summary["isolated_robots"]):
        screen.print(
            f"exchanged no frames with other robots: {', '.join(map(str, alone))}; if they were in range, their "
            "[radio], keys, or settings differ: murmur robot prints which to compare"
        )
