"""Teams of `murmur robot` processes over UDP: real and simulated robots; robots that start late, leave, or return."""

from __future__ import annotations

import csv
import json
import math
import socket
import time
import tomllib
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.radios.team_key import create_key
from deploy.after.merge import merge
from protocol.grid import FREE
from protocol.transforms import Pose
from tests.agent.bodies.ros_house import WHERE, house
from tests.deploy.commands.office_floor import murmur
from tests.deploy.field.robot_processes import RobotProcess, settings, wait_until, write
from tests.deploy.field.ros_house_node import RosHouseNode, known_share
from tests.system.served_robots import serving
from worldsim import maps
from worldsim.maps import Map

RIGHT_ROOM = Pose(4.0, 1.2, 2.2)
FAST: dict[str, Any] = {"step_s": 0.2, "finish_s": 3.0, "strategy": "meier"}


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    """What it holds is closed at the end of the test."""
    with ExitStack() as opened:
        yield opened


@pytest.fixture
def port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        number: int = probe.getsockname()[1]
    return number


class HouseTeam:
    """Robots in one house, each with the process that drives it."""

    def __init__(self, folder: Path, router: str, port: int, stack: ExitStack, robots: int) -> None:
        create_key(folder / "team.key")
        self.folder, self._router, self._port, self._stack, self._robots = folder, router, port, stack, robots
        self.nodes: dict[int, RosHouseNode] = {}
        self.processes: dict[int, RobotProcess] = {}

    def place(self, number: int, start: Pose, **body: Any) -> None:
        """Put a ROS 2 robot into the house."""
        self.nodes[number] = RosHouseNode(self._router, house(), start, f"r{number}", **body)
        self._stack.callback(self.nodes[number].close)
        data = settings(self._router, self._port, robot=number, robots=self._robots, **FAST)
        pose = [start.x, start.y, math.degrees(start.yaw)]
        data["ros2"] |= {"map_pose": pose, "namespace": f"r{number}"}
        data["radio"] |= {"key": "../team.key", "sessions": "."}
        self.write(number, data)

    def write(self, number: int, data: dict[str, Any]) -> None:
        """Write the settings file of a robot."""
        write(self.folder / f"r{number}", data)

    def start(self, number: int, **changes: Any) -> RobotProcess:
        """Start the process of a robot, with some settings changed."""
        path = self.folder / f"r{number}" / "robot.toml"
        if changes:
            self.write(number, tomllib.loads(path.read_text(encoding="utf-8")) | changes)
        process = self.processes[number] = RobotProcess(path)
        self._stack.callback(process.close)
        return process

    def sent_since(self, number: int, start: int, time_ns: int) -> list[int]:
        """Return the bytes of each frame that a robot sent in one of its starts, from a time on."""
        path = self.folder / f"r{number}" / "record" / f"start-{start}" / "frames.csv"
        with path.open(encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        return [
            int(row["bytes"])
            for row in rows
            if int(row["sender"]) == number and int(row["time_ns"]) >= time_ns
        ]


@pytest.fixture
def team(tmp_path: Path, router: str, port: int, stack: ExitStack) -> HouseTeam:
    return HouseTeam(tmp_path, router, port, stack, robots=2)


def test_a_simulated_robot_and_a_real_one_explore_the_same_building(
    team: HouseTeam, stack: ExitStack
) -> None:
    """The test plays the real robot; `murmur serve-ros2` knows the building from a map file."""
    folder = team.folder
    maps.save(Map("house", house(), WHERE.resolution, (WHERE.x, WHERE.y, 0.0)), folder / "house.yaml")
    served = stack.enter_context(
        serving(
            "--map", str(folder / "house.yaml"), "--robots", "1", "--start", f"{RIGHT_ROOM.x},{RIGHT_ROOM.y}",
            "--speed", "4", "--sensor-range", "4", "--json", "--write-robots", str(folder / "simulated"),
            "--team", "2",
        )
    )  # fmt: skip
    written = tomllib.loads((folder / "simulated" / "r0.toml").read_text(encoding="utf-8"))
    assert (written["robot"], written["robots"]) == (0, 2)
    assert written["ros2"]["router"] == served.printed["router"]
    (folder / "team.key").write_bytes((folder / "simulated" / "team.key").read_bytes())
    team.place(1, Pose(0.0, 0.0, 0.0))
    real = tomllib.loads((folder / "r1" / "robot.toml").read_text(encoding="utf-8"))
    assert {name: real["grid"][name] for name in ("x", "y", "width_m", "height_m")} == {
        name: written["grid"][name] for name in ("x", "y", "width_m", "height_m")
    }
    team.write(0, written | FAST | {"radio": real["radio"], "record": {"folder": "record"}})
    first, second = team.start(0), team.start(1)
    assert (first.wait(), second.wait()) == (0, 0), first.output + second.output
    merged = merge([folder / "r0" / "record", folder / "r1" / "record"], folder / "team")
    assert merged.summary["worst_team_map_held"] > 0.95
    assert max(merged.summary["path_length"]) > 0.5
    assert merged.summary["frames"] > merged.summary["frames_lost"]
    assert any('"neighbors": [0]' in each for each in team.nodes[1].statuses)
    known = merged.maps["team"][house() == FREE]
    assert np.mean(known == FREE) > 0.95
    wait_until(lambda: known_share(team.nodes[1].team_map, house()) > 0.95)


@pytest.mark.long
def test_a_robot_that_starts_late_gets_the_whole_map_in_few_bytes(team: HouseTeam) -> None:
    team.place(0, Pose(0.0, 0.0, 0.0))
    team.place(1, RIGHT_ROOM, drives=False)
    first = team.start(0)
    wait_until(lambda: team.nodes[0].statuses and json.loads(team.nodes[0].statuses[-1])["explored"])
    began = time.monotonic_ns()
    second = team.start(1, absent_s=20.0)
    assert (first.wait(), second.wait()) == (0, 0), first.output + second.output
    assert json.loads(team.nodes[0].statuses[-1])["dropped"] == {}
    wait_until(lambda: known_share(team.nodes[1].team_map, house()) > 0.95)
    sent = team.sent_since(0, 1, began)
    assert sum(sent) < 1000 + 40 * len(sent)
    assert "malformed" not in second.output


@pytest.mark.parametrize("ending", ["stopped", pytest.param("killed", marks=pytest.mark.long)])
def test_a_robot_that_leaves_for_good_does_not_keep_its_teammate_from_finishing(
    team: HouseTeam, ending: str
) -> None:
    team.place(0, Pose(0.0, 0.0, 0.0))
    team.place(1, RIGHT_ROOM, drives=False)
    first, second = team.start(0, absent_s=4.0 if ending == "killed" else 300.0), team.start(1)
    wait_until(lambda: any('"neighbors": [1]' in each for each in team.nodes[0].statuses))
    if ending == "stopped":
        assert murmur("stop", str(team.folder / "r1" / "record")).exit_code == 0
        assert second.wait() == 1
    else:
        second.close()
    assert first.wait() == 0, first.output
    wait_until(lambda: known_share(team.nodes[0].team_map, house()) > 0.97)


@pytest.mark.long
def test_a_robot_beyond_the_size_of_the_team_is_explained_at_both_ends(team: HouseTeam) -> None:
    team.place(0, Pose(0.0, 0.0, 0.0), drives=False)
    team.place(1, RIGHT_ROOM, drives=False)
    first, other = team.start(0), team.start(1, robot=2, robots=3)
    wait_until(lambda: "robots beyond the size of its team, 2: all robots need the same" in first.output)
    wait_until(lambda: "the sender has another key, or settings that differ" in other.output)
    assert json.loads(team.nodes[0].statuses[-1])["neighbors"] == []


@pytest.mark.long
def test_a_robot_that_leaves_and_returns_continues(team: HouseTeam) -> None:
    team.place(0, Pose(0.0, 0.0, 0.0))
    team.place(1, RIGHT_ROOM)
    first, second = team.start(0), team.start(1)
    wait_until(lambda: any('"neighbors": [0]' in each for each in team.nodes[1].statuses))
    second.close()
    third = team.start(1, absent_s=20.0)
    assert (first.wait(), third.wait()) == (0, 0), first.output + third.output
    records = team.folder / "r1" / "record"
    assert sorted(path.name for path in records.glob("start-*")) == ["start-1", "start-2"]
    for node in team.nodes.values():
        wait_until(lambda node=node: known_share(node.team_map, house()) > 0.95)
    merged = merge([team.folder / "r0" / "record", records], team.folder / "team")
    assert merged.summary["worst_team_map_held"] > 0.95
