"""Settings files of robots, and `murmur robot` as a process, for tests."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import tomli_w

LIMIT_S = 120.0
"""Time limit of everything that is waited for; it is reached only if a test fails."""


def settings(router: str = "tcp/127.0.0.1:1", port: int = 7785, **changes: Any) -> dict[str, Any]:
    """Return the settings of the first robot in the house of `tests.agent.bodies.ros_house`; it drives fast."""
    usual = {
        "robot": 0, "robots": 1, "strategy": "meier", "sensor_range": 4.0, "speed": 4.0, "radius": 0.2,
        "step_s": 0.2, "finish_s": 1.0, "dead_man_s": 2.0,
        "grid": {"x": -1.0, "y": -1.0, "width_m": 6.2, "height_m": 4.2},
        "ros2": {"map_pose": [0.0, 0.0, 0.0], "router": router},
        "radio": {"medium": "udp", "interface": "lo", "udp_port": port, "interval_s": 0.2, "bytes_per_s": 500},
    }  # fmt: skip
    return usual | changes


def write(folder: Path, data: dict[str, Any]) -> Path:
    """Write a settings file."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "robot.toml"
    path.write_text(tomli_w.dumps(data), encoding="utf-8")
    return path


class RobotProcess:
    """`murmur robot` as a process; it is ended with the test."""

    def __init__(self, file: Path) -> None:
        self._out = (file.parent / "out.txt").open("w+")
        command = [sys.executable, "-m", "deploy.commands.main", "robot", str(file)]
        self.process = subprocess.Popen(command, stdout=self._out, stderr=subprocess.STDOUT)

    @property
    def output(self) -> str:
        """What it has printed so far."""
        self._out.seek(0)
        return self._out.read()

    def wait(self) -> int:
        """Wait until it ends; return its exit code."""
        return self.process.wait(LIMIT_S)

    def close(self) -> None:
        """Kill the process if it still runs."""
        self.process.kill()
        self.process.wait()
        self._out.close()


def wait_until(condition: Callable[[], object]) -> None:
    """Wait until a condition holds; AssertionError after `LIMIT_S`."""
    end = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < end, "the condition did not hold in time"
        time.sleep(0.02)
