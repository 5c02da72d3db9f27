"""`murmur setup` and `doctor`: prepare the installation, and check it."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import platform
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from deploy.commands.console import errors, fail, screen
from deploy.commands.flags import command_family, option

app = command_family()

MAX_COMPILERS = 4
"""Processes that compile kernels at once, at most; each needs half a gigabyte."""

WITHOUT_LIBRARY = (
    "no library, so each process loads numba (130 MB, 1.7 s): with a C compiler and Python's headers, "
    "`murmur setup` builds it"
)


@app.command()
def setup() -> None:
    """Compile the kernels for this machine, once, which takes a minute.

    With a C compiler and Python's headers, they become a library, from which every process starts without numba.
    Without these, numba keeps them in its cache. If this command is not called, the first run compiles them before its
    first step. The error stream shows the progress. Exit codes: 0 the kernels are ready, 1 they cannot be kept, so each
    start compiles again.
    """
    from deploy.run import processes  # noqa: F401, PLC0415  all kernels, which it must not load
    from protocol.kernels import compile_in_parallel  # noqa: PLC0415
    from protocol.native.build import BuildError, build_library  # noqa: PLC0415
    from worldsim import people, world  # noqa: F401, PLC0415

    jobs, compiled = min(os.cpu_count() or 1, MAX_COMPILERS), 0
    try:
        compiled = build_library(jobs)
    except BuildError as error:
        errors.print(Text(f"no library of kernels: {error}"))
    compiled += compile_in_parallel(jobs)
    try:
        screen.print(f"kernels: {_kernels(compiled)}")
    except RuntimeError as error:
        fail(str(error), 1)


@app.command()
def doctor(
    ros2: Annotated[
        Path | None,
        option("ROBOT.toml", "check the ROS 2 nodes of the robot with this settings file instead"),
    ] = None,
) -> None:
    """Check that this installation works: versions, compiled kernels, a small swarm on each bus.

    With --ros2, find out why a robot in the field stands still: key, router, nodes, topics, frames, and clocks. Exit
    codes: 0 all is well, 1 something is wrong, 2 the settings file is wrong.
    """
    if ros2 is not None:
        raise typer.Exit(0 if _robot_is_well(ros2) else 1)
    passed = True
    for name, check in CHECKS.items():
        try:
            screen.print(Text.assemble(("ok", "green"), f"     {name}: {check()}"))
        except Exception as error:
            passed = False
            screen.print(Text.assemble(("failed", "red"), f" {name}: {error}"))
    raise typer.Exit(0 if passed else 1)


def _robot_is_well(file: Path) -> bool:
    """Print the findings of all checks of a robot in the field; return whether nothing is wrong."""
    from deploy.field.robot_file import load_robot  # noqa: PLC0415

    settings = load_robot(file)
    from deploy.field.doctor import RobotDoctor, SkippedError, Trouble  # noqa: PLC0415

    doctor, is_well = RobotDoctor(settings), True
    with contextlib.closing(doctor):
        for name, check in doctor.checks():
            try:
                screen.print(Text.assemble(("ok", "green"), f"      {name}: {check()}"))
            except SkippedError as error:
                screen.print(f"skipped {name}: {error}")
            except Trouble as error:
                is_well = False
                screen.print(Text.assemble(("failed", "red"), f"  {name}: {error}"))
                if error.fix:
                    screen.print(f"        fix: {error.fix}")
    return is_well


def _packages() -> str:
    from deploy.record.versions import versions  # noqa: PLC0415

    return ", ".join(f"{name} {version}" for name, version in versions().items() if name != "python")


def _kernels(compiled_before: int = 0) -> str:
    """Load all kernels, compile missing ones, and return how; RuntimeError if they cannot be kept."""
    import deploy.run.preload  # noqa: F401, PLC0415
    from protocol.kernels import NO_CACHE, cache_folder, compiled, loaded  # noqa: PLC0415
    from protocol.native.library import library_file  # noqa: PLC0415

    if not cache_folder():
        raise RuntimeError(NO_CACHE)
    ready = f"{loaded() + compiled()} ready, {compiled_before + compiled()} of them compiled now"
    if file := library_file():
        return f"{ready}; library {file}"
    return f"{ready}; cache below {cache_folder()}; {WITHOUT_LIBRARY}"


def _swarm(bus: str) -> str:
    from deploy.record.number_texts import counted  # noqa: PLC0415
    from deploy.run import exploration  # noqa: PLC0415
    from deploy.scenario.scenario import parse  # noqa: PLC0415
    from protocol.temporary import temporary_folder  # noqa: PLC0415

    scenario = parse({"map": "em", "robots": 2, "bus": bus, "steps": 30})
    with temporary_folder() as folder:
        result = exploration.explore(scenario, out=folder / "run")
    if result.deaths or result.records.lost:
        raise RuntimeError(f"processes died: {result.deaths or result.records.lost}")
    return f"{counted(result.summary['steps'], 'step')}, {result.summary['steps_per_s']} steps/s"


def _viewer() -> str:
    if importlib.util.find_spec("rerun") is None:
        return "not installed; --view needs it: pip install 'murmur-robots[view]'"
    return "Rerun installed"


CHECKS: dict[str, Callable[[], str]] = {
    "python": platform.python_version,
    "packages": _packages,
    "kernels": _kernels,
    "swarm on the memory bus": lambda: _swarm("memory"),
    "swarm on Zenoh": lambda: _swarm("zenoh"),
    "viewer": _viewer,
}
"""The checks of `murmur doctor`; each returns its finding, or raises an error with advice."""
