"""Settings files of robots: what is wrong, where, and what would be right."""

from __future__ import annotations

import json
import tomllib
from dataclasses import fields
from pathlib import Path
from typing import Any, get_args

import pytest

from deploy.field.robot_file import (
    EXAMPLE,
    GridTable,
    RadioTable,
    RecordTable,
    RobotSettings,
    Ros2Table,
    load_robot,
)
from deploy.field.robot_plan import agent_settings, map_frame
from deploy.scenario.errors import ScenarioError
from protocol.range_scans import TURN, Laser
from protocol.ros2.messages import DISTROS
from tests.deploy.commands.office_floor import murmur
from tests.deploy.field.robot_processes import settings, write


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"robot": 2}, "robot = 2: the last robot of 1 has number 0"),
        ({"robots": "two"}, "robots = 'two': must be a whole number"),
        ({"robots": 2, "teammate": [{"robot": 2}]}, "[[teammate]] names robot 2; the last one is 1"),
        ({"robots": 2, "teammate": [{"robot": 0}]}, "names robot 0, which is this robot: set its values"),
        ({"robots": 2, "teammate": 2 * [{"robot": 1}]}, "[[teammate]] names a robot twice: [1, 1]"),
        (
            {"robots": 2, "teammate": [{"robot": 1, "laser": "x"}]},
            "teammate.0.laser: unknown setting; there are:",
        ),
        (
            {"robots": 2, "teammate": [{"robot": 1, "sensor_range": 0.1}]},
            "sensor_range = 0.1: must be two cells",
        ),
        ({"colour": 1}, "colour: unknown setting; there are: strategy, options, map_encoding"),
        ({"strategy": "meyer"}, "did you mean meier?"),
        ({"strategy": "playback"}, "strategy = 'playback': does not explore"),
        ({"options": {"depth": 1}}, "has no option 'depth'"),
        ({"map_encoding": "jpeg"}, "map_encoding = 'jpeg'"),
        ({"step_s": 0}, "step_s = 0: must be greater than or equal to 0.1"),
        ({"starts": 256, "robots": 2}, "starts = 256: packets can address 256 maps"),
        ({"grid": {"x": 0.0, "y": 0.0, "width_m": 5.0}}, "grid.height_m is missing"),
        (
            {"grid": {"x": 0.0, "y": 0.0, "width_m": 1e5, "height_m": 5.0}},
            "robot.toml: grid.width_m: is 1000000 cells of 0.1 m",
        ),
        ({"ros2": {}}, "ros2.map_pose is missing"),
        ({"ros2": {"map_pose": [0, 0]}}, "ros2.map_pose"),
        (
            {"ros2": {"map_pose": [0.0, 0.0, 0.0], "scans": "x"}},
            "ros2.scans: unknown setting; did you mean scan",
        ),
        ({"ros2": {"map_pose": [0.0, 0.0, 0.0], "distro": "foxy"}}, "ros2.distro = 'foxy': must be 'humble'"),
        (
            {"ros2": {"map_pose": [0.0, 0.0, 0.0], "goal_pose": "", "navigate_to_pose": ""}},
            "ros2: goal_pose and navigate_to_pose are both empty",
        ),
        (
            {"ros2": {"map_pose": [0.0, 0.0, 0.0], "scan": "", "map": ""}},
            "ros2: scan and map are both empty, so that the robot has no readings",
        ),
        ({"ros2": 3}, "ros2 = 3: must be a table of map_pose, router, domain"),
        (
            {"ros2": {"map_pose": [0.0, 0.0, 0.0], "router": "x"}},
            "robot.toml: ros2.router = 'x': must be as tcp/localhost:7447",
        ),
        *(
            ({"ros2": {"map_pose": [0.0, 0.0, 0.0], **names}}, message)
            for names, message in (
                (
                    {"scan": "l\u00e4ser"},
                    "scan: 'l\u00e4ser' in namespace '/' is not a name of ROS: parts between",
                ),
                ({"tf": ""}, "tf: '' in namespace '/' is not a name of ROS"),
                ({"namespace": "r 1"}, "'murmur' in namespace 'r 1' is not a name of ROS"),
                ({"node": "1"}, "'1' is not the name of a node"),
                ({"router": "localhost"}, "router = 'localhost': must be as tcp/localhost:7447"),
                ({"router": "tcp/localhost"}, "router = 'tcp/localhost': must be as tcp/localhost:7447"),
                (
                    {"map_frame": "/map"},
                    "map_frame = '/map': must be the name of a frame, without a slash in",
                ),
                (
                    {"namespace": "r1", "team_map": "/r1/map"},
                    "team_map = '/r1/map': is the topic of map as well",
                ),
            )
        ),
        (
            {"map_encoding": "scans", "ros2": {"map_pose": [0.0, 0.0, 0.0], "scan": ""}},
            "ros2.scan = \"\": map_encoding = 'scans' sends laser scans; choose another encoding",
        ),
        (
            {"radio": {"medium": "udp"}},
            "interface is missing: name the one that frames go through, as 'wlan0'",
        ),
        ({"radio": {"medium": "smoke"}}, "radio.medium = 'smoke': must be 'udp' or 'serial'"),
        (
            {"radio": {"medium": "udp", "interface": "lo", "baud": "fast"}},
            "baud = 'fast': must be a whole number",
        ),
        (
            {"radio": {"medium": "udp", "interface": "lo", "keys": ""}},
            "radio.keys: unknown setting; did you mean key",
        ),
        (
            {"radio": {"medium": "udp", "interface": "lo", "key": ""}},
            "radio.key = '': must not be empty",
        ),
        ({"record": {"folder": ""}}, "record.folder = '': must not be empty"),
    ],
)
def test_a_wrong_setting_is_named_with_what_would_be_right(
    changes: dict[str, Any], message: str, tmp_path: Path
) -> None:
    path = write(tmp_path, settings(**changes))
    with pytest.raises(ScenarioError) as error:
        load_robot(path)
    assert message in str(error.value)
    assert all(line.startswith(f"robot {path}: ") for line in str(error.value).splitlines())


def test_all_errors_are_listed_at_once(tmp_path: Path) -> None:
    result = murmur("robot", str(write(tmp_path, settings(robots=0, seed=-1, speed=0.0))))
    assert result.exit_code == 2
    assert [line.split(": ")[2].split(" =")[0] for line in result.stderr.splitlines()] == [
        "robots",
        "seed",
        "speed",
    ]


def test_the_example_is_valid_and_names_every_setting(tmp_path: Path) -> None:
    result = murmur("robot", "--example")
    assert result.exit_code == 0
    path = tmp_path / "robot.toml"
    path.write_text(result.stdout, encoding="utf-8")
    assert load_robot(path).settings.robots == 2
    radio_of_modems = "frame_bytes", "hello_s", "interval_s", "neighbor_timeout_s"
    tables = {"polygons", "predictive", "options", "teammate"}
    for table in (RobotSettings, GridTable, Ros2Table, RecordTable):
        for name in table.model_fields:
            assert name in tables or f"{name} = " in result.stdout or f"[{name}]" in result.stdout, name
    for name in (each.name for each in fields(RadioTable)):
        assert name in radio_of_modems or f"{name} = " in result.stdout, name
    assert "[[teammate]]" in result.stdout


def test_commented_values_of_the_example_are_the_defaults() -> None:
    text = EXAMPLE.read_text(encoding="utf-8")
    given = tomllib.loads(text)
    lines = [
        line[2:] if line.startswith("# ") and " = " in line.partition("  ")[0] else line
        for line in text.splitlines()
        if not line.startswith("# For a ")
    ]
    spelled_out = tomllib.loads("\n".join(lines))
    assert len(spelled_out) > len(given)
    assert RobotSettings(**spelled_out) == RobotSettings(**given)


def test_distributions_are_those_of_the_node() -> None:
    assert get_args(Ros2Table.model_fields["distro"].annotation) == DISTROS


def test_the_grid_and_the_control_logic_follow_from_the_settings(tmp_path: Path) -> None:
    file = load_robot(write(tmp_path, settings(robots=3, robot=1, step_s=0.5)))
    where = map_frame(file.settings)
    assert (where.width, where.height, where.resolution, where.x, where.y) == (62, 42, 0.1, -1.0, -1.0)
    agent = agent_settings(file.settings, Laser(91, -TURN // 8, TURN // 4, 4000))
    assert (agent.robot, agent.robots, agent.width, agent.height) == (1, 3, 62, 42)
    assert agent.body.speed == pytest.approx(4.0 * 0.5 / 0.1)
    assert agent.body.field_of_view == 90
    assert agent.medium.bandwidth.limit == 3 * 500 * 0.5
    assert agent.bodies == (agent.body,) * 3


def test_the_control_logic_plans_with_what_the_file_says_of_teammates(tmp_path: Path) -> None:
    teammates = [{"robot": 2, "sensor_range": 12.0}, {"robot": 0, "radius": 0.5}]
    file = load_robot(write(tmp_path, settings(robots=3, robot=1, teammate=teammates)))
    laser = Laser(91, -TURN // 8, TURN // 4, 4000)
    agent = agent_settings(file.settings, laser)
    assert agent.ranges_of(range(3)).tolist() == [40.0, 40.0, 120.0]
    assert [body.radius_cells for body in agent.bodies] == [5.0, 2.0, 2.0]
    assert [body.laser for body in agent.bodies] == [laser] * 3


def test_paths_are_relative_to_the_settings_file(tmp_path: Path) -> None:
    file = load_robot(write(tmp_path / "deep", settings(record={"folder": "runs/r0"})))
    assert file.record == tmp_path / "deep" / "runs" / "r0"
    assert (file.key, file.sessions) == (tmp_path / "deep" / "team.key", tmp_path / "deep")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "name the settings file of the robot"),
        (["missing.toml"], "robot missing.toml: no such file"),
        (
            ["--check", "{file}"],
            "team.key: No such file or directory; copy the team's key file to this robot",
        ),
    ],
)
def test_the_command_ends_with_code_2(arguments: list[str], message: str, tmp_path: Path) -> None:
    file = str(write(tmp_path, settings()))
    result = murmur("robot", *(each.format(file=file) for each in arguments))
    assert result.exit_code == 2
    assert message in result.stderr


@pytest.mark.parametrize(
    ("scan", "source"),
    [
        ("scan", "laser scans on 'scan', with poses from 'tf'"),
        ("", "its own map on 'map', up to 4 m (sensor_range) around its poses from 'tf', as scan is empty"),
    ],
)
def test_the_check_says_what_the_robots_map_is_made_of(scan: str, source: str, tmp_path: Path) -> None:
    data = settings()
    data["ros2"]["scan"] = scan
    file = write(tmp_path, data)
    assert murmur("keys", "--team-key", str(tmp_path / "team.key")).exit_code == 0
    result = murmur("robot", "--check", str(file))
    assert result.exit_code == 0
    assert result.stdout.splitlines()[1] == f"the robot's part of the team's map comes from {source}"


@pytest.mark.parametrize(("table", "key"), [("record", "folder"), ("radio", "sessions")])
def test_the_check_finds_a_directory_that_cannot_be_created(table: str, key: str, tmp_path: Path) -> None:
    data = settings()
    data[table] = data.get(table, {}) | {key: "team.key/r0"}
    file = write(tmp_path, data)
    assert murmur("keys", "--team-key", str(tmp_path / "team.key")).exit_code == 0
    result = murmur("robot", "--check", str(file))
    assert result.exit_code == 2
    assert (
        f"{table}.{key} = {tmp_path / 'team.key/r0'}: {tmp_path / 'team.key'} is not a directory"
        in result.stderr
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([file.name, "team.key"])


@pytest.mark.parametrize(
    ("radio", "text"),
    [
        (
            {"medium": "udp", "interface": "lo"},
            "UDP on interface lo, address 239.77.85.82, port 7785; 116,822 bytes per second, frames of at most "
            "1,400 bytes; teammates are out of range after 32.0 s",
        ),
        (
            {"medium": "serial", "serial_port": "/dev/ttyUSB0", "preset": "lora-sf9", "duty_cycle": 0.01},
            "modem at /dev/ttyUSB0, 57600 baud; 169 bytes per second, frames of at most 115 bytes, 1 % of each hour "
            "(full frames: 53.2); teammates are out of range after 229.8 s",
        ),
    ],
)
def test_the_check_says_what_the_radio_may_send(radio: dict[str, Any], text: str, tmp_path: Path) -> None:
    file = write(tmp_path, settings() | {"radio": radio})
    assert murmur("keys", "--team-key", str(tmp_path / "team.key")).exit_code == 0
    assert murmur("robot", "--check", str(file)).stdout.splitlines()[2] == f"radio: {text}"


@pytest.mark.parametrize(
    "router",
    [
        "tcp/[::1]:7447",
        "tls/robot.local:7447",
        "tcp/127.0.0.1:7447#iface=lo",
        "unixsock-stream//tmp/zenoh.sock",
    ],
)
def test_all_addresses_of_zenoh_are_accepted(router: str) -> None:
    assert Ros2Table(map_pose=(0.0, 0.0, 0.0), router=router).router == router


def test_a_router_that_does_not_answer_is_named(tmp_path: Path) -> None:
    file = write(tmp_path, settings("tcp/127.0.0.1:9", port=17999))
    assert murmur("keys", "--team-key", str(tmp_path / "team.key")).exit_code == 0
    assert murmur("robot", "--check", str(file)).exit_code == 0
    result = murmur("robot", str(file))
    assert result.exit_code == 2
    assert "ros2.router = 'tcp/127.0.0.1:9': no Zenoh router answers" in result.stderr


def test_the_guides_list_each_setting_with_its_default() -> None:
    docs = Path(__file__).parents[3] / "docs"
    for page, table, without in (
        (
            "field.md",
            RobotSettings,
            {"grid", "ros2", "radio", "record", "predictive", "polygons", "teammate"},
        ),
        ("ros2.md", Ros2Table, set()),
    ):
        lines = (docs / page).read_text(encoding="utf-8").splitlines()
        for name, field in table.model_fields.items():
            if name in without:
                continue
            factory = field.default_factory is not None
            default = "" if field.is_required() else f"`{json.dumps({} if factory else field.default)}`"
            row = f"| `{name}` | {default} | {field.description} |"
            assert row in lines, row
