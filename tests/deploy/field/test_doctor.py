"""`murmur doctor --ros2`: what it finds for a robot that the test plays, and the advice for each fault."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from agent.radios.team_key import create_key
from deploy.field import connection, listener
from deploy.field.doctor import RobotDoctor, Trouble
from deploy.field.robot_file import RobotFile, RobotSettings
from protocol.ros2.messages import LASER_SCAN, POSE_STAMPED
from protocol.ros2.node import Ros2Node
from protocol.ros2.qos import DEFAULT, SENSOR
from protocol.transforms import Pose
from tests.agent.bodies.ros_house import house
from tests.deploy.commands.office_floor import murmur
from tests.deploy.field.robot_processes import settings, write
from tests.deploy.field.ros_house_node import RosHouseNode

SECOND = 10**9
AT_ORIGIN = Pose(0.0, 0.0, 0.0)
ALL = [
    "key",
    "radio",
    "start pose",
    "router",
    "nodes",
    "tf",
    "tf_static",
    "scan",
    "map",
    "frames",
    "clocks",
    "goals",
]


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(listener, "LISTEN_S", 1.5)
    monkeypatch.setattr(listener, "ENOUGH_S", 0.2)


@pytest.fixture
def play(router: str) -> Iterator[Callable[..., RosHouseNode]]:
    """Start a robot, which is closed at the end of the test."""
    with ExitStack() as stack:

        def begin(**options: Any) -> RosHouseNode:
            ros = RosHouseNode(router, house(), AT_ORIGIN, "r0", **options)
            stack.callback(ros.close)
            return ros

        yield begin


def examine(folder: Path, router: str, changes: dict[str, Any] | None = None) -> tuple[int, dict[str, str]]:
    """Return the exit code of the command, and the finding of each check, with its first word and its fix."""
    data = settings(router)
    data["ros2"] |= {"namespace": "r0"} | (changes or {})
    if not (folder / "team.key").exists():
        create_key(folder / "team.key")
    result = murmur("doctor", "--ros2", str(write(folder, data)))
    assert result.stderr == ""
    findings: dict[str, str] = {}
    for line in result.stdout.splitlines():
        if line.startswith("        fix: "):
            findings[list(findings)[-1]] += f" [{line.strip()}]"
        else:
            verdict, rest = line.split(maxsplit=1)
            name, _, finding = rest.partition(": ")
            findings[name] = f"{verdict} {finding}"
    return result.exit_code, findings


def test_nothing_is_wrong_with_a_robot_that_offers_everything(play: Any, router: str, tmp_path: Path) -> None:
    play(has_action=True)
    code, findings = examine(tmp_path, router)
    assert list(findings) == ALL
    assert all(each.startswith("ok ") for each in findings.values()), findings
    assert code == 0
    assert "/r0/house_robot" in findings["nodes"]
    assert "per second" in findings["scan"]
    assert findings["frames"] == "ok the robot is at (0.00, 0.00) m, 0 degrees in the common frame"
    assert findings["goals"] == "ok over the action navigate_to_pose, to /r0/house_robot"


def test_a_robot_without_scans_needs_none(play: Any, router: str, tmp_path: Path) -> None:
    ros = play()
    ros.sends_scans = False
    code, findings = examine(tmp_path, router, {"scan": ""})
    assert code == 0, findings
    assert list(findings) == [each for each in ALL if each != "scan"]
    assert findings["goals"] == "ok over goal_pose, to /r0/house_robot"


def test_without_a_router_the_other_checks_are_skipped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise ConnectionError

    monkeypatch.setattr(connection, "Ros2Node", refuse)
    code, findings = examine(tmp_path, "tcp/127.0.0.1:9")
    assert code == 1
    assert findings["router"] == (
        "failed no Zenoh router answers at tcp/127.0.0.1:9 "
        "[fix: start it with: ros2 run rmw_zenoh_cpp rmw_zenohd; or set ros2.router]"
    )
    assert all(findings[name] == "skipped no router answers" for name in ALL[4:])


@pytest.mark.parametrize(
    ("radio", "problem"),
    [
        ({"medium": "udp", "interface": "wlan-9"}, "interface 'wlan-9' does not exist; there are: "),
        (
            {"medium": "serial", "serial_port": "/dev/none", "preset": "lora-sf9"},
            "port /dev/none: No such file or directory",
        ),
        (
            {"medium": "serial", "serial_port": "/etc/passwd", "preset": "lora-sf9"},
            "port /etc/passwd is no serial port",
        ),
    ],
)
def test_a_radio_that_cannot_be_used_is_found(radio: dict[str, Any], problem: str, tmp_path: Path) -> None:
    doctor = RobotDoctor(RobotFile(RobotSettings(**settings() | {"radio": radio}), tmp_path))
    with pytest.raises(Trouble, match=f"^{problem}"):
        doctor.radio()


@pytest.mark.parametrize(
    ("angle", "warns"),
    [(1.57, True), (-3.1416, True), (0.79, True), (0.0, False), (90.0, False), (2.0, False)],
)
def test_a_heading_in_radians_is_pointed_out(angle: float, warns: bool, tmp_path: Path) -> None:
    data = settings(robots=2)
    data["ros2"]["map_pose"] = [1.0, 0.0, angle]
    doctor = RobotDoctor(RobotFile(RobotSettings(**data), tmp_path))
    assert doctor.start_pose().endswith("looks like radians") == warns


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        (
            {"map_pose": [50.0, 0.0, 0.0], "scan": "lidar", "map": "plan", "goal_pose": "target"},
            {
                "start pose": "(50, 0) m, 0 degrees is outside of the grid [fix: set ros2.map_pose to where",
                "scan": "nothing publishes /r0/lidar [fix: set ros2.scan to one of: /r0/scan]",
                "map": "nothing publishes /r0/plan [fix: set ros2.map to one of: /r0/map]",
                "goals": "no node takes goals over navigate_to_pose or target [fix: start nav2, or set ros2.",
            },
        ),
        (
            {"namespace": "r1"},
            {
                "scan": "nothing publishes /r1/scan [fix: set ros2.scan to one of: /r0/scan; or, if all topics are "
                'missing, set ros2.namespace = "r0"]',
            },
        ),
        (
            {"domain": 3},
            {
                "nodes": "no node is visible in domain 3 [fix: nodes are visible in domain 0: set ros2.domain]",
                "scan": 'nothing publishes /r0/scan [fix: start the node that publishes it, or set ros2.scan = ""',
            },
        ),
        (
            {"map_frame": "world"},
            {
                "map": "/r0/map is in frame 'map', not 'world' [fix: set ros2.map_frame = \"map\"]",
                "frames": "no transforms (tf) from 'world' to the laser's frame 'laser'; only map -> odom",
            },
        ),
        (
            {"distro": "humble", "scan": "map", "map": ""},
            {
                "tf": 'another definition of tf2_msgs/msg/TFMessage than humble [fix: set ros2.distro = "jazzy"]',
                "scan": "/r0/map has messages of type nav_msgs/msg/OccupancyGrid, not sensor_msgs/msg/LaserScan",
            },
        ),
    ],
)
def test_wrong_settings_are_named_with_what_would_be_right(
    play: Any, router: str, tmp_path: Path, changes: dict[str, Any], expected: dict[str, str]
) -> None:
    play()
    code, findings = examine(tmp_path, router, changes)
    assert code == 1
    for name, finding in expected.items():
        assert findings[name].startswith("failed ")
        assert finding in findings[name]


def test_a_silent_laser_and_a_key_for_all_users_are_found(play: Any, router: str, tmp_path: Path) -> None:
    play().sends_scans = False
    create_key(tmp_path / "team.key")
    (tmp_path / "team.key").chmod(0o644)
    code, findings = examine(tmp_path, router)
    assert code == 1
    assert "has mode 644" in findings["key"]
    assert "chmod 600" in findings["key"]
    assert "/r0/house_robot publishes /r0/scan, but no message has arrived" in findings["scan"]
    assert findings["frames"].startswith("failed no laser scan has arrived")


def test_two_robots_with_the_same_topics_are_found(play: Any, router: str, tmp_path: Path) -> None:
    play()
    play()
    code, findings = examine(tmp_path, router)
    assert code == 1
    for name in ("scan", "map"):
        assert f"2 publishers send /r0/{name}: /r0/house_robot, /r0/house_robot" in findings[name]
        assert "if these are several robots, give each a namespace" in findings[name]


@pytest.mark.parametrize(
    ("stamp", "finding"),
    [
        (lambda now: now - 5 * SECOND, " s before those of tf [fix: synchronize the clocks"),
        (lambda now: 7, "stamps of /r0/scan advance by 0.00 s"),
    ],
)
def test_clocks_that_differ_or_stand_still_are_found(
    play: Any, router: str, tmp_path: Path, stamp: Callable[[int], int], finding: str
) -> None:
    ros = play()
    scan = ros._robot.scan
    ros._robot.scan = lambda now: scan(stamp(now))
    code, findings = examine(tmp_path, router)
    assert code == 1
    assert findings["clocks"].startswith("failed ")
    assert finding in findings["clocks"]


def test_nodes_of_another_distribution_do_not_hide_the_one_that_fits(
    play: Any, router: str, tmp_path: Path
) -> None:
    play().sends_scans = False
    with ExitStack() as stack:
        for number in range(4):
            other = stack.enter_context(Ros2Node(f"other{number}", "r0", distro="humble", router=router))
            other.subscription("goal_pose", POSE_STAMPED, DEFAULT, lambda *_: None)
            other.publisher("scan", LASER_SCAN, SENSOR)
        _, findings = examine(tmp_path, router, {"navigate_to_pose": ""})
    assert findings["goals"] == "ok over goal_pose, to /r0/house_robot"
    assert findings["scan"].endswith('[fix: set ros2.distro = "humble"]')


def test_a_wrong_settings_file_ends_with_code_2(tmp_path: Path) -> None:
    result = murmur("doctor", "--ros2", str(write(tmp_path, settings(robots=0))))
    assert result.exit_code == 2
    assert "robots = 0" in result.stderr
