"""`murmur serve-ros2`: simulated robots that look like ROS 2 robots, a swarm to develop against."""

from __future__ import annotations

import json
import math
import re
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from deploy.commands.console import errors, screen
from deploy.commands.flags import ROBOTS, command_family, flag, option, switch
from deploy.commands.scenario_flags import run_flags
from deploy.scenario.errors import ScenarioError
from deploy.scenario.scenario import Scenario, load
from protocol.nanoseconds import SECOND

if TYPE_CHECKING:
    from deploy.serve.agent_files import AgentFiles
    from deploy.serve.process import ServeSettings
    from deploy.serve.swarm import Swarm

app = command_family()

ROS = "ROS 2"
RADIUS_M = 0.2
"""Default of `radius`: robots that ROS drives are no points."""
MIN_RATE, MAX_RATE = 1.0, 100.0
NOT_SERVED = (
    "strategy", "min_frontier_size", "range", "bandwidth", "map_encoding", "dissemination", "tolerance", "steps",
    "finish", "bus", "clock",
)  # fmt: skip
"""Settings of runs with agents, radio, and records."""
SERVED = {
    "radius": flag("radius", float, option("METERS", f"radius of the robots (default {RADIUS_M:g})", ROBOTS))
}


@app.command("serve-ros2")
@run_flags(*NOT_SERVED, "radio.preset", "step_s", more=SERVED)
def serve_ros2(
    names: Annotated[str | None, option("A,B,...", "namespaces (default r0,r1,...)", ROS)] = None,
    sees_robots: Annotated[
        bool, switch("--sees-robots", "lasers see other robots, instead of filtering them", ROBOTS)
    ] = False,
    rate: Annotated[float, option("HZ", "scans and transforms per second", ROS)] = 10.0,
    domain: Annotated[int, option("ID", "ROS_DOMAIN_ID", ROS)] = 0,
    distro: Annotated[str, option("NAME", "distribution, as jazzy or humble", ROS)] = "jazzy",
    router: Annotated[str | None, option("ADDRESS", "use this router, and start none", ROS)] = None,
    listen: Annotated[
        str | None, option("ADDRESS", "of the router that it starts (default tcp/localhost:7447)", ROS)
    ] = None,
    sim_time: Annotated[
        bool, switch("--sim-time", "publish /clock, and use simulated time in stamps", ROS)
    ] = False,
    no_slam: Annotated[bool, switch("--no-slam", "publish neither map nor map -> odom", ROS)] = False,
    no_navigation: Annotated[bool, switch("--no-navigation", "take no goals, only cmd_vel", ROS)] = False,
    write_robots: Annotated[
        Path | None, option("DIR", "write a settings file for the agent of each robot, and a key", ROS)
    ] = None,
    team: Annotated[
        int | None, option("N", "with --write-robots: all robots of the team, with real ones", ROS)
    ] = None,
    interface: Annotated[
        str | None, option("NAME", "with --write-robots: of the agents' radio (default lo)", ROS)
    ] = None,
    as_json: Annotated[
        bool, switch("--json", "print the robots, and at the end the coverage, as lines of JSON")
    ] = False,
    *,
    settings: dict[str, Any],
) -> None:
    """Serve simulated robots that look like ROS 2 robots over Zenoh, until Ctrl-C.

    Each robot publishes scan, tf, tf_static, odom, and map in its namespace. It accepts goal_pose, cmd_vel, and the
    action navigate_to_pose. docs/ros2.md describes them.
    """
    scenario = _scenario(settings)
    if router is not None and listen is not None:
        raise ValueError(f"listen = {listen!r}: --router starts no router; remove one of them")
    if not MIN_RATE <= rate <= MAX_RATE:
        raise ValueError(f"rate = {rate:g}: must be {MIN_RATE:g} to {MAX_RATE:g} Hz")
    from deploy.scenario.plan import make  # noqa: PLC0415
    from deploy.serve.process import ServeSettings, serve  # noqa: PLC0415
    from deploy.serve.ros_robot import Offers  # noqa: PLC0415
    from protocol.ros2.session import ROUTER  # noqa: PLC0415

    chosen = ServeSettings(
        namespaces=_namespaces(names, scenario.robots),
        domain=domain,
        distro=distro,
        router=router or listen or ROUTER,
        own_router=router is None,
        sim_time=sim_time,
        rate=rate,
        sees_robots=sees_robots,
        offers=Offers(slam=not no_slam, navigation=not no_navigation),
    )
    files = _agent_files(write_robots, team, interface, chosen.namespaces)

    def ready(swarm: Swarm) -> None:
        if files is not None:
            files.write(scenario, swarm, chosen)
        (_print_json if as_json else _print_text)(scenario, swarm, chosen, files)

    swarm = serve(make(scenario), chosen, ready, errors.print)
    if as_json:
        print(json.dumps({"coverage": swarm.world.coverage, "seconds": swarm.time_ns / SECOND}), flush=True)
    else:
        screen.print(f"The robots have seen {swarm.world.coverage:.1%} of what they can reach.")


def _agent_files(
    folder: Path | None, team: int | None, interface: str | None, names: tuple[str, ...]
) -> AgentFiles | None:
    """Return the files to write for agents; ValueError for options without a directory."""
    from deploy.serve.agent_files import AgentFiles  # noqa: PLC0415

    if folder is not None:
        return AgentFiles(folder, len(names) if team is None else team, interface or "lo", names)
    for name, value in (("team", team), ("interface", interface)):
        if value is not None:
            raise ValueError(f"{name} = {value}: belongs to the files of --write-robots, which is missing")
    return None


def _scenario(settings: dict[str, Any]) -> Scenario:
    """Return the scenario of the simulated robots; ScenarioError for settings that only runs have."""
    for name in settings:
        if name.partition(".")[0] in (*NOT_SERVED, "radio", "options", "recording", "fault", "scanner_turn"):
            raise ScenarioError(f"set = '{name}=...': has no meaning for robots that ROS drives; omit it")
    radius = settings.setdefault("radius", RADIUS_M)
    if isinstance(radius, int | float):
        settings.setdefault("start_spacing", max(0.3, 4.0 * radius))
    return load(None, settings)


def _namespaces(names: str | None, robots: int) -> tuple[str, ...]:
    """Return one namespace per robot; ValueError if names are repeated, too few, or too many."""
    found = tuple(f"r{robot}" for robot in range(robots)) if names is None else tuple(names.split(","))
    if len(set(found)) != robots or len(found) != robots:
        raise ValueError(f"names = {names!r}: give {robots} different names, one per robot, or --robots")
    for name in found:
        if re.fullmatch("[A-Za-z_][A-Za-z0-9_]*", name) is None:
            raise ValueError(
                f"names = {names!r}: {name!r} is not a namespace, as r0: "
                "letters, digits, and underscores, no digit first"
            )
    return found


def _print_json(scenario: Scenario, swarm: Swarm, chosen: ServeSettings, _: AgentFiles | None) -> None:
    """Print the router, the map, and the robots as a line of JSON."""
    from deploy.serve.agent_files import grid  # noqa: PLC0415

    starts = [[*robot.start[:2], math.degrees(robot.start.yaw)] for robot in swarm.robots]
    found = {
        "router": chosen.router, "domain": chosen.domain, "distro": chosen.distro, "map": scenario.map,
        "grid": grid(swarm), "robots": dict(zip(chosen.namespaces, starts, strict=True)),
    }  # fmt: skip
    print(json.dumps(found), flush=True)


def _print_text(scenario: Scenario, swarm: Swarm, chosen: ServeSettings, files: AgentFiles | None) -> None:
    """Print the map and the router, and how to start the agents with their settings files, or else the settings."""
    from deploy.serve.agent_files import file_settings  # noqa: PLC0415

    started = "a router started" if chosen.own_router else "the router"
    screen.print(
        f"{scenario.robots} robots on map {scenario.map}, at {started} at {chosen.router}, "
        f"domain {chosen.domain}, {chosen.distro}. Ctrl-C ends them."
    )
    if files is not None:
        screen.print("\nStart their agents:")
        for namespace in chosen.namespaces:
            screen.print(f"murmur robot {shlex.quote(str(files.path(namespace)))}")
    else:
        screen.print("\nSettings of their agents (--write-robots DIR writes whole files):")
        for robot, namespace in enumerate(chosen.namespaces):
            screen.print(f"\n# {namespace}.toml")
            for name, value in file_settings(scenario, swarm, chosen, robot).items():
                screen.print(f"{name} = {_toml(value)}")
    sys.stdout.flush()  # for a program that reads them


def _toml(value: Any) -> str:
    """Return a value of TOML, tables on one line."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{name} = {_toml(each)}" for name, each in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value)
