"""Benchmark of one robot in the field: memory and processor share of `murmur robot` beside simulated ROS 2 robots.

Two robots explore an office at five steps per second, and exchange maps over UDP on loopback. Robot 0 is measured.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import tomli_w

from agent.radios.team_key import create_key
from deploy.bench.measurement import Measurement
from deploy.dashboard.windows import free_port

SIDES_M = (20, 50)
ROBOTS = 2
STEP_S = 0.2
WARM_UP_S = 15.0
"""Seconds after the first step before the measurement begins; most kernels are loaded then."""
MEASURED_S = 45.0
START_S = 180.0
"""Seconds in which the robot must begin; the first start after an installation compiles kernels."""
END_S = 30.0
MURMUR = (sys.executable, "-m", "deploy.commands.main")
MEMORY = {"VmRSS": "memory", "RssAnon": "memory, anonymous"}
"""Names of lines of ``/proc/PID/status``, and of the figures that they give."""


def field() -> Iterator[Measurement]:
    """Measure a robot in offices of several sizes; MissingPackageError without a package that ROS 2 needs."""
    import protocol.ros2.node  # noqa: F401, PLC0415  raises the error now, not in the robot's process

    for side in SIDES_M:
        name = f"robot in an office of {side} m x {side} m"
        with tempfile.TemporaryDirectory() as folder, _team(side, Path(folder)) as process:
            _wait(WARM_UP_S, process)
            began, worked = time.monotonic(), _processor_s(process.pid)
            _wait(MEASURED_S, process)
            share = (_processor_s(process.pid) - worked) / (time.monotonic() - began)
            for key, what in MEMORY.items():
                yield Measurement(f"{name}: {what}", "MB", _memory_mb(process.pid, key))
            yield Measurement(f"{name}: processor", "% of a core", 100 * share)


@contextmanager
def _team(side_m: float, folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run simulated robots, and an agent for each; yield the process of robot 0 once it has begun."""
    create_key(folder / "team.key")
    port = free_port()
    with ExitStack() as stack:
        served = _serve(side_m, stack)
        processes = []
        for robot, (namespace, pose) in enumerate(served["robots"].items()):
            settings = {
                "robot": robot, "robots": ROBOTS, "speed": 1.0, "step_s": STEP_S, "finish_s": 3600.0,
                "grid": served["grid"],
                "ros2": {"namespace": namespace, "map_pose": pose, "router": served["router"]},
                "radio": {"medium": "udp", "interface": "lo", "udp_port": port, "sessions": namespace},
                "record": {"folder": namespace},
            }  # fmt: skip
            file = folder / f"{namespace}.toml"
            file.write_text(tomli_w.dumps(settings), encoding="utf-8")
            output = stack.enter_context((folder / f"{namespace}.txt").open("w+b"))
            processes.append(_start(["robot", str(file)], stack, stdout=output, stderr=subprocess.STDOUT))
        first, began = folder / next(iter(served["robots"])), time.monotonic()
        while not list(first.glob("start-1/steps.csv")):
            if processes[0].poll() is not None or time.monotonic() - began > START_S:
                raise ConnectionError(f"robot 0 did not begin: {first.with_suffix('.txt').read_text()}")
            time.sleep(0.1)
        yield processes[0]


def _serve(side_m: float, stack: ExitStack) -> dict[str, Any]:
    """Start the simulated robots; return what the command printed of them."""
    size = [word for name in ("width_m", "height_m") for word in ("--set", f"map_options.{name}={side_m:g}")]
    process = _start(
        ["serve-ros2", "--map", "office", *size, "--robots", str(ROBOTS), "--speed", "1", "--json",
         "--listen", f"tcp/127.0.0.1:{free_port()}"], stack, stdout=subprocess.PIPE,
    )  # fmt: skip
    assert process.stdout is not None
    line = process.stdout.readline()
    if not line:
        raise ConnectionError("murmur serve-ros2 ended; the message above says why")
    printed: dict[str, Any] = json.loads(line)
    return printed


def _start(arguments: Sequence[str], stack: ExitStack, **streams: Any) -> subprocess.Popen[bytes]:
    """Start a command of Murmur, which ends with `stack`."""
    process = subprocess.Popen([*MURMUR, *arguments], **streams)

    def end() -> None:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    stack.callback(end)
    return process


def _wait(seconds: float, process: subprocess.Popen[bytes]) -> None:
    """Wait; ConnectionError if the process ends before."""
    try:
        process.wait(seconds)
    except subprocess.TimeoutExpired:
        return
    raise ConnectionError("robot 0 ended before it could be measured")


def _processor_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _memory_mb(pid: int, key: str) -> float:
    """Return a size from the status of a process in MB."""
    lines = Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines()
    (line,) = [each for each in lines if each.startswith(f"{key}:")]
    return int(line.split()[1]) * 1024 / 1e6
