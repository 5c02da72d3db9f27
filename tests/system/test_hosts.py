"""A run on two hosts, with a real SSH server in a network namespace, behind 20 ms of delay and a loss of 1 %."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from deploy.run.exploration import explore
from deploy.scenario.scenario import load
from tests.deploy.commands.office_floor import murmur
from tests.system.far_host import NEAR, NEAR_6, ROOT, FarHost, far_host, why_not

PATIENCE_S = 120
ROUND_TRIP_MS, LOSS = 20.0, 0.01
STEPS = 25
REASON = why_not()

pytestmark = pytest.mark.skipif(bool(REASON), reason=REASON)


@pytest.fixture(scope="module")
def far(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FarHost]:
    with far_host(tmp_path_factory.mktemp("far"), ROUND_TRIP_MS, LOSS) as host:
        yield host


def write_inputs(folder: Path, far: FarHost, scenario: str, address: str = NEAR, **changes: str) -> None:
    (folder / "team.toml").write_text(f'map = "em"\nrobots = 3\n{scenario}')
    (folder / "hosts.toml").write_text(far.hosts(address, **changes))


@contextlib.contextmanager
def launched(folder: Path, far: FarHost) -> Iterator[subprocess.Popen[str]]:
    words = ["explore", "team.toml", "--hosts", "hosts.toml", "--out", "run", "--json"]
    process = subprocess.Popen(
        far.command(sys.executable, "-m", "deploy.commands.main", *words),
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def wait_until(true: Callable[[], object], process: subprocess.Popen[str] | None = None) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not true():
        assert process is None or process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.05)


def has_begun(folder: Path) -> bool:
    """Whether the robots have sent anything by radio."""
    capture = folder / "run" / "radio.pcapng"
    return capture.exists() and capture.stat().st_size > 5_000


def title(pid: int) -> str:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode().strip()
    return ""


@pytest.mark.parametrize(
    ("address", "router"),
    [pytest.param(NEAR, "false", id="IPv4"), pytest.param(NEAR_6, "true", id="IPv6 through a router")],
)
@pytest.mark.long
def test_delay_and_loss_change_no_result_and_no_secret_is_on_a_command_line(
    far: FarHost, tmp_path: Path, address: str, router: str
) -> None:
    write_inputs(tmp_path, far, f"steps = {STEPS}\n", address, robots="2", router=router)
    seen: set[str] = set()
    with launched(tmp_path, far) as run:
        wait_until(lambda: has_begun(tmp_path), run)
        live = json.loads((tmp_path / "run" / "live.json").read_text())
        seen |= {title(int(path.name)) for path in Path("/proc").iterdir() if path.name.isdigit()}
        there = {title(pid) for pid in far.processes()}
        output, faults = run.communicate(timeout=PATIENCE_S)
    assert run.returncode == 1, faults
    assert not faults
    assert {"murmur robots", "murmur r0", "murmur r1"} <= there
    assert ("murmur router@far" in there) == (router == "true")
    assert "murmur r2" not in there
    assert "murmur r2" in seen
    assert any(line.startswith("ssh ") for line in seen)
    assert live["hub"].startswith("tls/10.213.77.1:" if address == NEAR else f"tls/[{address}]:")
    assert not any("PRIVATE KEY" in line or live["certificate"]["key"].split()[4] in line for line in seen)
    here = explore(load(tmp_path / "team.toml", {"bus": "memory"}), keep=False)
    assert json.loads(output)["digest"] == here.summary["digest"]
    assert not (tmp_path / "run" / "logs").exists()
    assert far.processes() == []


@pytest.mark.long
def test_a_link_of_16_kilobytes_per_second_changes_no_result(tmp_path: Path) -> None:
    """On this map, two robots report 260 kB of map changes every five steps."""
    with far_host(tmp_path, bytes_per_s=16_000) as far:
        write_inputs(tmp_path, far, "steps = 8\n", robots="2")
        with launched(tmp_path, far) as run:
            output, faults = run.communicate(timeout=PATIENCE_S)
    assert run.returncode == 1, faults
    here = explore(load(tmp_path / "team.toml", {"bus": "memory"}), keep=False)
    assert json.loads(output)["digest"] == here.summary["digest"]


@pytest.mark.long
def test_a_run_on_two_hosts_by_the_wall_clock_is_repeated_from_its_record(
    far: FarHost, tmp_path: Path
) -> None:
    write_inputs(tmp_path, far, f'steps = {STEPS}\nclock = "wall"\nstep_s = 0.5\n', robots="2")
    with launched(tmp_path, far) as run:
        output, faults = run.communicate(timeout=PATIENCE_S)
    assert run.returncode == 1, faults
    summary = json.loads(output)
    assert (summary["steps"], summary["clock"], summary["lost"]) == (STEPS, "wall", {})
    assert all(missed < STEPS for missed in summary["missed_steps_by_robot"]), "each robot has moved"
    assert min(summary["path_length"]) > 0
    result = murmur("replay", str(tmp_path / "run"))
    assert result.exit_code == 0, result.stderr
    assert far.processes() == []


def test_a_far_robot_that_dies_is_named_with_its_host_and_the_others_finish(
    far: FarHost, tmp_path: Path
) -> None:
    write_inputs(tmp_path, far, f"steps = {STEPS + 10}\n", robots="[0, 2]")
    with launched(tmp_path, far) as run:
        wait_until(lambda: has_begun(tmp_path), run)
        (victim,) = (pid for pid in far.processes() if title(pid) == "murmur r2")
        os.kill(victim, signal.SIGKILL)
        output, faults = run.communicate(timeout=PATIENCE_S)
    assert run.returncode == 3
    assert "r2 died: on far: killed by SIGKILL, no output" in faults
    assert re.search("^robot 2 was lost: its process ended.*; it ran on host far$", faults, re.M)
    assert list(json.loads(output)["lost"]) == ["2"]
    assert json.loads(output)["steps"] == STEPS + 10
    assert far.processes() == []


@pytest.mark.long
def test_a_lost_connection_is_reported_with_its_robots(far: FarHost, tmp_path: Path) -> None:
    write_inputs(tmp_path, far, "speed = 0.005\n", robots="3")
    with launched(tmp_path, far) as run:
        wait_until(lambda: has_begun(tmp_path), run)
        (ssh,) = (
            int(path.name)
            for path in Path("/proc").iterdir()
            if path.name.isdigit() and re.match("ssh .* run agents$", title(int(path.name)))
        )
        os.kill(ssh, signal.SIGTERM)
        _, faults = run.communicate(timeout=PATIENCE_S)
    assert run.returncode == 3
    assert re.search(r"^far died: .*; with it r0, r1, r2$", faults, re.M), faults
    wait_until(lambda: far.processes() == [])


@pytest.mark.long
def test_a_host_that_vanishes_is_named_and_the_others_finish(far: FarHost, tmp_path: Path) -> None:
    write_inputs(tmp_path, far, f"steps = {STEPS + 10}\n", robots="2")
    with launched(tmp_path, far) as run:
        wait_until(lambda: has_begun(tmp_path), run)
        with far.vanished():
            output, faults = run.communicate(timeout=PATIENCE_S)
    assert run.returncode == 3
    for robot in (0, 1):
        assert re.search(
            rf"^robot {robot} was lost: .*connection was cut.*; it ran on host far$", faults, re.M
        )
    assert json.loads(output)["steps"] == STEPS + 10
    wait_until(lambda: far.processes() == [])


def test_a_launcher_that_is_killed_leaves_nothing_behind(far: FarHost, tmp_path: Path) -> None:
    write_inputs(tmp_path, far, "speed = 0.005\n", robots="2")
    with launched(tmp_path, far) as run:
        wait_until(lambda: has_begun(tmp_path), run)
        run.kill()
        wait_until(lambda: far.processes() == [])
        near = subprocess.run(["ip", "netns", "pids", far.near], capture_output=True, text=True, check=True)
        wait_until(lambda: not any(title(int(pid)) for pid in near.stdout.split()))


def test_an_unusable_host_is_reported_before_anything_starts(far: FarHost, tmp_path: Path) -> None:
    write_inputs(tmp_path, far, "", port="2223")
    with launched(tmp_path, far) as run:
        _, faults = run.communicate(timeout=PATIENCE_S)
    assert run.returncode == 2
    assert re.fullmatch(
        r"murmur: host far: ssh cannot reach 10\.213\.77\.2: .*Connection refused\n"
        r"murmur: ssh must connect without a prompt; test it with: ssh .* 10\.213\.77\.2 true\n",
        faults,
    )
    assert not (tmp_path / "run").exists()
