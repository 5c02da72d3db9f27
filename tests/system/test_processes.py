"""Swarms of real processes: what happens when one of them dies, and that none outlives a run."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest

from deploy.after import archive

MURMUR = [sys.executable, "-m", "deploy.commands.main"]
SWARM = ["explore", "--map", "office", "--robots", "3", "--map-encoding", "scans", "--bandwidth", "2000"]

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


def wait_for_steps(process: subprocess.Popen[str]) -> None:
    child(process, "r2")
    time.sleep(1.5)


def test_a_killed_robot_is_reported_and_the_others_finish(tmp_path: Path) -> None:
    with swarm(tmp_path / "run") as process:
        wait_for_steps(process)
        child(process, "r1").kill()
        code, said, _ = finish(process, 120)
    assert code == 3
    assert "r1" in said
    assert "SIGKILL" in said
    result = summary(tmp_path / "run")
    assert result["finished"]
    assert result["coverage"] == 1.0
    assert result["lost"] == {"1": "its process ended"}


def test_a_robot_that_hangs_is_named_and_ended_and_the_others_finish(tmp_path: Path) -> None:
    with swarm(tmp_path / "run", "--set", "patience=1.0") as process:
        wait_for_steps(process)
        stopped = child(process, "r1")
        stopped.suspend()
        code, said, _ = finish(process, 60)
    assert code == 3
    assert "robot 1 was lost: timed out after 1 s" in said
    assert "died" not in said
    assert not stopped.is_running()
    result = summary(tmp_path / "run")
    assert result["coverage"] == 1.0
    assert list(result["lost"]) == ["1"]


@pytest.mark.parametrize("name", ["relay", "world"])
def test_a_relay_or_world_that_hangs_ends_the_run_and_is_named(tmp_path: Path, name: str) -> None:
    with swarm(tmp_path / "run", *SLOW, "--set", "patience=0.5") as process:
        wait_for_steps(process)
        family = descendants(process)
        child(process, name).suspend()
        code, said, _ = finish(process, 30)
    assert code == 3
    assert f"no message from the {name} for" in said
    assert not psutil.wait_procs(family, timeout=3)[1]


@pytest.mark.parametrize("name", ["relay", "world"])
def test_a_killed_relay_or_world_ends_the_run_and_is_named(tmp_path: Path, name: str) -> None:
    with swarm(tmp_path / "run", *SLOW) as process:
        wait_for_steps(process)
        family = descendants(process)
        child(process, name).kill()
        code, said, _ = finish(process, 30)
    assert code == 3
    assert f"{name} died: killed by SIGKILL" in said
    assert " died: exit code" not in said
    assert not psutil.wait_procs(family, timeout=3)[1]
    result = summary(tmp_path / "run")
    assert not result["finished"]
    assert result["steps"] > 0
    assert (tmp_path / "run" / "ledger.parquet").exists()
    assert (tmp_path / "run" / "steps.parquet").exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_ends_all_children_and_writes_what_there_is(tmp_path: Path, number: int) -> None:
    with swarm(tmp_path / "run", *SLOW) as process:
        wait_for_steps(process)
        family = descendants(process)
        os.kill(process.pid, number)
        time.sleep(0.5)
        os.kill(process.pid, number)  # once more, for the end takes a while
        code, said, _ = finish(process, 30)
    assert code == 1
    assert said.startswith("Not finished after")
    assert "interrupted" in said
    assert said.endswith("ending after this step; writing the run directory\n")
    assert not psutil.wait_procs(family, timeout=3)[1]
    result = summary(tmp_path / "run")
    assert result["reason"] == "interrupted"
    assert 0 < result["coverage"] < 1
    assert (tmp_path / "run" / "maps.png").exists()


def test_ctrl_c_which_all_in_the_terminal_get_ends_a_run_that_is_watched_to_its_last_step(
    tmp_path: Path,
) -> None:
    out = tmp_path / "run"
    with swarm(out, "--pictures", *SLOW) as process:
        wait_for_steps(process)
        os.killpg(process.pid, signal.SIGINT)
        code, said, _ = finish(process, 60)
    assert code == 1, said
    assert archive.read(out).maps.steps(0)[-1] == summary(out)["steps"]
    assert (out / "pictures" / "channel-load.png").exists()


def test_ctrl_c_while_processes_are_being_started_ends_the_run_as_well(tmp_path: Path) -> None:
    with swarm(tmp_path / "run", *SLOW) as process:
        while not any("forkserver" in " ".join(each.cmdline()) for each in descendants(process)):
            time.sleep(0.02)
        time.sleep(0.5)
        family = descendants(process)
        os.killpg(process.pid, signal.SIGINT)
        code, said, _ = finish(process, 60)
    assert code == 1, said
    assert "Traceback" not in said
    assert not psutil.wait_procs(family, timeout=10)[1]


@pytest.mark.parametrize("moment", ["at the start", "under way"])
def test_a_launcher_that_is_killed_leaves_no_process_and_no_folder_behind(
    tmp_path: Path, moment: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    long_name = tmp_path / ("long" * 40)
    folder = long_name if moment == "under way" else tmp_path / "short"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    with swarm(tmp_path / "run", *SLOW) as process:
        if moment == "under way":
            wait_for_steps(process)
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
    assert not list(folder.glob("pymp-*"))
    assert not [each for each in folders if each.exists()]


def test_a_fork_server_that_is_killed_is_named_once(tmp_path: Path) -> None:
    with swarm(tmp_path / "run", *SLOW) as process:
        wait_for_steps(process)
        family = descendants(process)
        parents = {found.ppid() for found in family}
        (server,) = [found for found in family if found.pid in parents]
        server.kill()
        code, said, _ = finish(process, 60)
    assert code == 3
    assert said.count(" died: ") == 1
    assert "the fork server died: " in said
    assert not psutil.wait_procs(family, timeout=20)[1]


def test_replay_repeats_a_run_from_its_directory_alone(tmp_path: Path) -> None:
    out = tmp_path / "run"
    subprocess.run([*MURMUR, *SWARM, "--bus", "memory", "--out", str(out)], check=True, capture_output=True)
    moved = tmp_path / "elsewhere" / "moved"
    moved.parent.mkdir()
    out.rename(moved)
    again = subprocess.run([*MURMUR, "replay", str(moved)], check=False, capture_output=True, text=True)
    assert again.returncode == 0, again.stderr
    tampered = summary(moved) | {"digest": "0" * 64}
    (moved / "summary.json").write_text(json.dumps(tampered))
    again = subprocess.run(
        [*MURMUR, "replay", "--bus", "memory", str(moved)], check=False, capture_output=True, text=True
    )
    assert again.returncode == 1
    assert "Replay differs" in again.stderr
