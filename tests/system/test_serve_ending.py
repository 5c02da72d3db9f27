"""The end of murmur serve-ros2 at a terminal, and the commands that it prints for users to copy."""

from __future__ import annotations

import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed: pip install 'murmur-robots[ros2]'")
pytest.importorskip("xxhash", reason="xxhash is not installed: pip install 'murmur-robots[ros2]'")

from tests.system.served_robots import free_address

COMMAND = (sys.executable, "-m", "deploy.commands.main", "serve-ros2", "--map", "em", "--robots", "2")


def test_a_second_ctrl_c_does_not_interrupt_the_end(tmp_path: Path) -> None:
    folder = tmp_path / "dry run"
    command = (*COMMAND, "--listen", free_address(), "--write-robots", str(folder))
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            printed = [
                next(line for line in process.stdout if f"r{robot}.toml" in line) for robot in range(2)
            ]
        finally:
            for _ in range(3):
                process.send_signal(signal.SIGINT)
                time.sleep(0.02)
        output, _ = process.communicate(timeout=30)
    assert process.returncode == 0
    assert "The robots have seen" in output
    assert [shlex.split(line) for line in printed] == [
        ["murmur", "robot", str(folder / f"r{robot}.toml")] for robot in range(2)
    ]
