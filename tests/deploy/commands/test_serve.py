"""murmur serve-ros2 refuses bad input before it opens anything; tests/system/test_serve_ros2.py runs it."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed: pip install 'murmur-robots[ros2]'")
pytest.importorskip("xxhash", reason="xxhash is not installed: pip install 'murmur-robots[ros2]'")

from tests.deploy.commands.office_floor import murmur


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ("--names a,b", "names = 'a,b': give 3 different names, one per robot"),
        ("--names a,b,a", "names = 'a,b,a': give 3 different names"),
        ("--names a,b,c/d", "names = 'a,b,c/d': 'c/d' is not a namespace, as r0"),
        ("--names a,b,3", "names = 'a,b,3': '3' is not a namespace, as r0"),
        ("--domain 300", "domain 300 is not from 0 to 232"),
        ("--distro iron", "distro = 'iron': there are: humble, jazzy"),
        ("--rate 0", "rate = 0: must be 1 to 100 Hz"),
        ("--router tcp/localhost:1 --listen tcp/localhost:2", "--router starts no router"),
        ("--listen nowhere", "'nowhere' is not an address to listen at"),
        ("--laser sick", "laser.preset = 'sick'"),
        ("--people 3", "choose a laser.preset with errors"),
        ("--radius 9", "sensor_range = 5 m of robot 0 is less than 9.18 m"),
        ("--set strategy=meier", "has no meaning for robots that ROS drives"),
        ("--set radio.loss=0.1", "has no meaning for robots that ROS drives"),
        ("--team 3", "team = 3: belongs to the files of --write-robots, which is missing"),
        ("--interface lo", "interface = lo: belongs to the files of --write-robots, which is missing"),
        ("--write-robots . --team 2", "team = 2: must be the number of all robots, of which 3 are simulated"),
        ("--map nowhere", "unknown map 'nowhere'"),
    ],
)
def test_bad_input_is_explained(arguments: str, reason: str) -> None:
    result = murmur("serve-ros2", *arguments.split())
    assert result.exit_code == 2
    assert reason in " ".join(result.stderr.split())


def test_an_address_in_use_is_refused_before_files_are_written(tmp_path: Path) -> None:
    folder = tmp_path / "robots"
    with socket.create_server(("127.0.0.1", 0)) as other:
        address = f"tcp/127.0.0.1:{other.getsockname()[1]}"
        result = murmur("serve-ros2", "--map", "em", "--listen", address, "--write-robots", str(folder))
    assert result.exit_code == 2 and not folder.exists()
    output = " ".join(result.stderr.split())
    assert f"cannot listen at {address}: the address is in use, or not one of this host" in output
    assert f"name another one with --listen, or --router {address} if a Zenoh router runs there" in output
