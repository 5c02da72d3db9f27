"""Runs of real processes: the effect of a process that dies or hangs, and that none outlives its run."""

from __future__ import annotations

import json
import os
import pty
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil
import pytest

from deploy.after import archive
from deploy.record.run_directory import CAPTURE

MURMUR = [sys.executable, "-m", "deploy.commands.main"]
SIDES = ["--set", "map_options.width_m=16", "--set", "map_options.height_m=16"]
SWARM = [
    "explore",
    "--map",
    "office",
    *SIDES,
    "--robots",
    "3",
    "--map-encoding",
    "scans",
    "--bandwidth",
    "2000",
]

SLOW = ["--pace", "20"]
"""For runs that are to be under way when something happens to them."""


@contextmanager
def swarm(out: Path, *more: str) -> Iterator[subprocess.Popen[str]]:
    """A swarm under way, in a terminal of its own."""
    process = subprocess.Popen(
        [*MURMUR, *SWARM, "--out", str(out), *more],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()


def child(process: subprocess.Popen[str], name: str, timeout_s: float = 60) -> psutil.Process:
    """Wait for the child of that name; it has joined the bus once others have as well."""
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        for found in descendants(process):
            try:
                if found.cmdline()[:1] == [f"murmur {name}"]:
                    return found
            except psutil.NoSuchProcess:
                continue
        time.sleep(0.02)
    raise AssertionError(f"no process of {name} within {timeout_s} s")


def descendants(process: subprocess.Popen[str]) -> list[psutil.Process]:
    try:
        return psutil.Process(process.pid).children(recursive=True)
    except psutil.NoSuchProcess:
        return []


def finish(process: subprocess.Popen[str], timeout_s: float) -> tuple[int, str, float]:
    """Exit code, everything printed, and seconds until the end."""
    began = time.monotonic()
    out, err = process.communicate(timeout=timeout_s)
    return process.returncode, out + err, time.monotonic() - began


def summary(out: Path) -> dict[str, object]:
    read: dict[str, object] = json.loads((out / "summary.json").read_text())
    return read


def wait_for_steps(out: Path, process: subprocess.Popen[str], least: int = 10_000) -> None:
    """Wait until some steps are over, judged by the bytes of the radio capture: some 2000 per step."""
    wait_for(out / CAPTURE, process, least)


def wait_for(path: Path, process: subprocess.Popen[str], least: int = 1) -> None:
    deadline = time.monotonic() + 60
    while not path.exists() or path.stat().st_size < least:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline, f"{path} has not come to {least} bytes within 60 s"
        time.sleep(0.02)


def test_a_killed_robot_is_reported_and_the_others_finish(tmp_path: Path) -> None:
    with swarm(tmp_path / "run") as process:
        wait_for_steps(tmp_path / "run", process)
        child(process, "r1").kill()
        code, output, _ = finish(process, 120)
    assert code == 3
    assert "r1" in output
    assert "SIGKILL" in output
    result = summary(tmp_path / "run")
    assert result["finished"]
    assert result["coverage"] == 1.0
    assert result["lost"] == {"1": "its process ended"}


def test_a_robot_that_hangs_is_named_and_ended_and_the_others_finish(tmp_path: Path) -> None:
    with swarm(tmp_path / "run", "--set", "reply_timeout_s=1.0") as process:
        wait_for_steps(tmp_path / "run", process)
        stopped = child(process, "r1")
        stopped.suspend()
        code, output, _ = finish(process, 60)
    assert code == 3
    assert "robot 1 was lost: timed out after 1 s" in output
    assert "died" not in output
    assert not stopped.is_running()
    result = summary(tmp_path / "run")
    assert result["coverage"] == 1.0
    assert list(result["lost"]) == ["1"]


@pytest.mark.parametrize("name", ["relay", pytest.param("world", marks=pytest.mark.long)])
def test_a_relay_or_world_that_hangs_ends_the_run_and_is_named(tmp_path: Path, name: str) -> None:
    with swarm(tmp_path / "run", *SLOW, "--set", "reply_timeout_s=0.5") as process:
        wait_for_steps(tmp_path / "run", process)
        family = descendants(process)
        child(process, name).suspend()
        code, output, _ = finish(process, 30)
    assert code == 3
    assert f"{name} died: it was stopped for 0.25 s, and was killed" in output
    assert summary(tmp_path / "run")["lost"] == {}
    assert not psutil.wait_procs(family, timeout=3)[1]


@pytest.mark.parametrize("name", [pytest.param("relay", marks=pytest.mark.long), "world"])
def test_a_killed_relay_or_world_ends_the_run_and_is_named(tmp_path: Path, name: str) -> None:
    with swarm(tmp_path / "run", *SLOW) as process:
        wait_for_steps(tmp_path / "run", process)
        family = descendants(process)
        child(process, name).kill()
        code, output, _ = finish(process, 30)
    assert code == 3
    assert f"{name} died: killed by SIGKILL" in output
    assert " died: exit code" not in output
    assert not psutil.wait_procs(family, timeout=3)[1]
    result = summary(tmp_path / "run")
    assert not result["finished"]
    assert result["steps"] > 0
    assert (tmp_path / "run" / "ledger.parquet").exists()
    assert (tmp_path / "run" / "steps.parquet").exists()


def test_a_relay_that_is_stopped_and_continued_costs_no_robot(tmp_path: Path) -> None:
    with swarm(tmp_path / "run", *SLOW, "--set", "reply_timeout_s=1.0") as process:
        wait_for_steps(tmp_path / "run", process)
        relay = child(process, "relay")
        relay.suspend()
        psutil.wait_procs([relay], timeout=2.5)
        with suppress(psutil.NoSuchProcess):
            relay.resume()
        code, output, _ = finish(process, 30)
    assert code == 3
    assert "relay died: it was stopped for 0.5 s, and was killed" in output
    assert "was lost" not in output
    assert summary(tmp_path / "run")["lost"] == {}


@pytest.mark.parametrize(
    "number",
    [signal.SIGINT, *(pytest.param(n, marks=pytest.mark.long) for n in (signal.SIGTERM, signal.SIGHUP))],
)
def test_an_interrupt_ends_all_children_and_writes_the_results_so_far(tmp_path: Path, number: int) -> None:
    with swarm(tmp_path / "run", *SLOW) as process:
        wait_for_steps(tmp_path / "run", process)
        family = descendants(process)
        os.kill(process.pid, number)
        time.sleep(0.1)
        os.kill(process.pid, number)  # once more, for the end takes a while
        code, output, _ = finish(process, 30)
    assert code == 1
    assert output.startswith("Not finished after")
    assert "interrupted" in output
    assert output.endswith("ending after this step; writing the run directory\n")
    assert not psutil.wait_procs(family, timeout=3)[1]
    result = summary(tmp_path / "run")
    assert result["reason"] == "interrupted"
    assert 0 < result["coverage"] < 1
    assert (tmp_path / "run" / "maps.png").exists()


def test_a_lost_terminal_ends_the_run_and_the_results_are_written(tmp_path: Path) -> None:
    out = tmp_path / "run"
    pid, terminal = pty.fork()
    if pid == 0:
        os.execv(sys.executable, [*MURMUR, *SWARM, *SLOW, "--out", str(out)])
    try:
        deadline = time.monotonic() + 30
        while not (out / "live.json").exists() and time.monotonic() < deadline:
            os.read(terminal, 1 << 16)
        time.sleep(1.5)
    finally:
        os.close(terminal)
    _, status = os.waitpid(pid, 0)
    assert os.waitstatus_to_exitcode(status) == 1
    assert summary(out)["reason"] == "interrupted"
    assert (out / "maps.png").exists()


def test_ctrl_c_to_all_processes_ends_a_run_with_a_viewer_after_a_whole_step(
    tmp_path: Path,
) -> None:
    out = tmp_path / "run"
    with swarm(out, "--pictures", *SLOW) as process:
        wait_for_steps(tmp_path / "run", process)
        os.killpg(process.pid, signal.SIGINT)
        code, output, _ = finish(process, 60)
    assert code == 1, output
    assert archive.read(out).maps.steps(0)[-1] == summary(out)["steps"]
    assert (out / "pictures" / "channel-load.png").exists()


@pytest.mark.long
def test_ctrl_c_while_processes_start_ends_the_run(tmp_path: Path) -> None:
    with swarm(tmp_path / "run", *SLOW) as process:
        while not any("forkserver" in " ".join(each.cmdline()) for each in descendants(process)):
            time.sleep(0.02)
        family = descendants(process)
        os.killpg(process.pid, signal.SIGINT)
        code, output, _ = finish(process, 60)
    assert code in (1, 130), output  # 130: before the run has begun
    assert "Traceback" not in output
    assert not psutil.wait_procs(family, timeout=10)[1]


@pytest.mark.parametrize("moment", [pytest.param("at the start", marks=pytest.mark.long), "under way"])
def test_a_launcher_that_is_killed_leaves_no_process_and_no_folder_behind(
    tmp_path: Path, moment: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    long_name = tmp_path / ("long" * 40)
    folder = long_name if moment == "under way" else tmp_path / "short"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    with swarm(tmp_path / "run", *SLOW) as process:
        if moment == "under way":
            wait_for_steps(tmp_path / "run", process)
        else:
            while len(descendants(process)) < 2:
                time.sleep(0.02)
        family = descendants(process)
        sockets = [Path(end.laddr) for each in family for end in each.net_connections("unix") if end.laddr]
        folders = {socket.parent for socket in sockets if socket.parent.name.startswith("pymp-")}
        process.kill()
        process.wait()
        _gone, alive = psutil.wait_procs(family, timeout=60)
    assert not alive
    assert folders or moment != "under way"
    assert not list(folder.iterdir())
    assert not [each for each in folders if each.exists()]


@pytest.mark.parametrize("number", [pytest.param(signal.SIGKILL, marks=pytest.mark.long), signal.SIGSTOP])
def test_a_fork_server_that_dies_or_hangs_is_named_once_and_all_is_written(
    tmp_path: Path, number: int
) -> None:
    with swarm(tmp_path / "run", *SLOW, "--set", "reply_timeout_s=1.0") as process:
        wait_for_steps(tmp_path / "run", process)
        family = descendants(process)
        parents = {found.ppid() for found in family}
        (server,) = [found for found in family if found.pid in parents]
        server.send_signal(number)
        code, output, _ = finish(process, 30)
    assert code == 3
    assert output.count(" died: ") == 1
    assert "the fork server died: " in output
    assert not psutil.wait_procs(family, timeout=20)[1]
    result = summary(tmp_path / "run")
    assert result["lost"] == {}
    assert result["steps"] > 0
    assert (tmp_path / "run" / "maps.png").exists()
