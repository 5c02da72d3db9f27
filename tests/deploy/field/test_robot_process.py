"""`murmur robot` as a process, against a ROS 2 robot that the test plays, over loopback."""

from __future__ import annotations

import json
import math
import re
import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.radios.team_key import create_key
from deploy.after.merge import merge
from deploy.after.report import write_report
from protocol.grid import FREE
from protocol.ros2.session import open_router
from protocol.transforms import Pose
from tests.agent.bodies.ros_house import house
from tests.deploy.commands.office_floor import murmur
from tests.deploy.field.robot_processes import RobotProcess, settings, wait_until, write
from tests.deploy.field.ros_house_node import RosHouseNode, known_share

AT_ORIGIN = Pose(0.0, 0.0, 0.0)


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    """What it holds is closed at the end of the test."""
    with ExitStack() as opened:
        yield opened


@pytest.fixture
def start(tmp_path: Path, router: str, stack: ExitStack) -> Callable[..., tuple[RosHouseNode, RobotProcess]]:
    """Start a ROS 2 robot and the process that drives it."""
    create_key(tmp_path / "team.key")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]

    def begin(name: str = "r0", body: dict[str, Any] | None = None, **changes: Any) -> Any:
        options = {"start": AT_ORIGIN} | (body or {})
        data = settings(router, port, **changes)
        where = options["start"]
        namespace = options.get("namespace", "/")
        data["ros2"] |= {"map_pose": [where.x, where.y, math.degrees(where.yaw)], "namespace": namespace}
        data["radio"] |= {"key": "../team.key", "sessions": "."}
        ros = RosHouseNode(router, house(), **options)
        stack.callback(ros.close)
        process = RobotProcess(write(tmp_path / name, data))
        stack.callback(process.close)
        return ros, process

    return begin


def test_a_robot_explores_a_house_and_shows_its_map(start: Any, tmp_path: Path) -> None:
    ros, process = start()
    assert process.wait() == 0, process.output
    assert "the robot stands still: nothing is left to explore" in process.output
    wait_until(lambda: "nothing is left" in ros.statuses[-1])
    status = json.loads(ros.statuses[-1])
    assert (status["robot"], status["explored"], status["undelivered"]) == (0, True, 0)
    assert status["known_cells"] > 2000
    assert known_share(ros.team_map, house()) > 0.97
    assert ros.team_map.header.frame_id == "map"
    assert {marker.ns for marker in ros.markers.markers} == {"frontiers", "target", "teammates"}
    assert len(ros.goals) < 40, "a goal is sent only if it changes"
    written = {path.name for path in (tmp_path / "r0" / "record").iterdir()}
    assert written == {"r0.journal", "robot.lock", "start-1"}


def test_a_robot_that_cannot_drive_gets_the_map_of_its_teammate_over_udp(start: Any, tmp_path: Path) -> None:
    # On a busy machine, entries arrive seconds late: a robot that ends sooner leaves its teammate with a frontier.
    first, one = start("r0", {"namespace": "r0"}, robots=2, robot=0, finish_s=8.0)
    stuck = {"start": Pose(4.0, 1.2, 2.2), "namespace": "r1", "drives": False}
    second, two = start("r1", stuck, robots=2, robot=1, finish_s=8.0)
    assert (one.wait(), two.wait()) == (0, 0), one.output + two.output
    assert any('"neighbors": [1]' in each for each in first.statuses)
    assert "teammates in range: robot 1\n" in one.output
    assert "teammates in range: robot 0\n" in two.output
    seen, free = json.loads(second.statuses[-1])["known_cells"], np.count_nonzero(house() == FREE)
    assert seen < 0.8 * free
    wait_until(lambda: known_share(second.team_map, house()) > 0.95)
    merged = merge([tmp_path / name / "record" for name in ("r0", "r1")], tmp_path / "team")
    summary = merged.summary
    assert (summary["finished"], summary["clock_error_s"], summary["coverage"]) == (True, 0, None)
    assert summary["frames"] > summary["frames_lost"]
    assert summary["worst_team_map_held"] > 0.95
    assert summary["worst_walls_within_tolerance"] > 0.9
    known = merged.maps["team"][house() == FREE]
    assert np.count_nonzero(known == FREE) > 0.95 * known.size
    assert summary["path_length"][0] > 1
    assert summary["path_length"][1] == 0
    page = write_report(tmp_path / "team").read_text(encoding="utf-8")
    assert "Explored in" in page


def test_murmur_stop_lets_the_robot_stand_still_where_it_is(start: Any, tmp_path: Path) -> None:
    ros, process = start(body={"drives": False})
    wait_until(lambda: ros.goals)
    result = murmur("stop", str(tmp_path / "r0" / "record"))
    assert result.exit_code == 0, result.stderr
    assert result.stdout == f"{tmp_path / 'r0' / 'record'}: stopped\n"
    assert process.wait() == 1
    assert "the robot stands still: stopped by murmur stop" in process.output
    wait_until(lambda: ros.goals[-1] == pytest.approx((0.0, 0.0), abs=0.01))
    assert murmur("stop", str(tmp_path / "r0" / "record")).exit_code == 2


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_cancels_the_goal_of_the_action(start: Any, number: signal.Signals) -> None:
    ros, process = start(body={"drives": False, "has_action": True})
    wait_until(lambda: ros.goals)
    process.process.send_signal(number)
    assert process.wait() == 1, process.output
    assert f"stopped by {number.name}" in process.output
    assert ros.cancels == 1


def test_a_robot_whose_scans_stop_stands_still_until_they_return(start: Any) -> None:
    ros, process = start(body={"drives": False}, dead_man_s=0.5)
    wait_until(lambda: ros.goals)
    ros.sends_scans = False
    wait_until(lambda: ros.goals[-1] == pytest.approx((0.0, 0.0), abs=0.01))
    wait_until(lambda: "stands still: no laser scan arrives any more" in process.output)
    ros.sends_scans = True
    wait_until(lambda: ros.goals[-1] != pytest.approx((0.0, 0.0), abs=0.01))


def test_a_robot_whose_scans_return_does_not_say_that_its_pose_has_jumped(start: Any) -> None:
    ros, process = start(body={"drives": False}, dead_man_s=0.5)
    wait_until(lambda: ros.goals)
    for outage in range(1, 4):
        ros.sends_scans = False
        wait_until(lambda seen=outage: process.output.count("stands still: no laser scan") == seen)
        ros.sends_scans = True
        wait_until(lambda: not process.output.splitlines()[-1].startswith("stands still"))
    assert "jumped" not in process.output


def test_a_robot_whose_router_ends_says_so(tmp_path: Path) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    data = settings(address)
    data["radio"] |= {"key": "team.key"}
    create_key(tmp_path / "team.key")
    with ExitStack() as opened:
        router = opened.enter_context(closing(open_router(address)))
        process = opened.enter_context(closing(RobotProcess(write(tmp_path, data))))
        wait_until(lambda: "waiting: no laser scan has arrived" in process.output)
        router.close()
        wait_until(
            lambda: f"waiting: the Zenoh router at {address} does not answer any more" in process.output
        )


def test_a_robot_without_a_map_gets_no_goals(start: Any) -> None:
    ros, process = start(body={"has_map": False})
    wait_until(lambda: "no map has arrived on map" in process.output)
    assert ros.goals == []


def test_a_target_that_the_robot_does_not_reach_is_avoided(start: Any) -> None:
    ros, process = start(body={"drives": False}, patience_s=1.0, avoid_s=60.0)
    wait_until(lambda: re.search(r"does not reach its target at \(\S+, \S+\) m in", process.output))
    first = ros.goals[0]
    wait_until(lambda: math.dist(ros.goals[-1], first) > 0.3)


def test_a_goal_that_the_action_aborts_is_avoided_at_once(start: Any) -> None:
    everywhere = tuple((x, y) for x in range(0, 62, 5) for y in range(0, 42, 5))
    ros, process = start(body={"has_action": True, "refuses": everywhere}, patience_s=600.0)
    wait_until(lambda: "does not reach its target" in process.output)
    assert len(ros.ended) > 0


def test_a_robot_that_has_used_up_its_starts_says_what_to_do(start: Any, tmp_path: Path) -> None:
    _, process = start(steps=2, starts=1)
    assert process.wait() == 1, process.output
    assert "the robot stands still: 2 steps are over" in process.output
    result = murmur("robot", str(tmp_path / "r0" / "robot.toml"))
    assert result.exit_code == 2
    assert "used up its 1 incarnations; for a new mission, choose a new record.folder" in result.stderr
    assert [path.name for path in (tmp_path / "r0" / "record").glob("start-*")] == ["start-1"]
