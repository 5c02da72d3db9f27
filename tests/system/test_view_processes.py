"""A viewer process that starts late, hangs or dies does not affect the run."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from deploy.after import archive
from deploy.dashboard.process import RECORDING
from deploy.dashboard.watch import LIVE
from deploy.dashboard.windows import binary
from deploy.run.exploration import explore
from deploy.scenario.scenario import load
from tests.system.headless import viewer
from tests.system.test_processes import child, finish, summary, swarm, wait_for, wait_for_steps

pytest.importorskip("rerun", reason="Rerun is not installed: pip install 'murmur-robots[view]'")


def verify(recording: Path) -> None:
    done = subprocess.run([binary(), "rrd", "verify", recording], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.long
def test_a_run_that_is_terminated_leaves_a_recording_that_opens(tmp_path: Path) -> None:
    out = tmp_path / "run"
    with swarm(out, "--view-as", "file") as process:
        wait_for_steps(out, process, 60_000)
        family = [*psutil.Process(process.pid).children(recursive=True)]
        process.terminate()
        code, output, _ = finish(process, 30)
    assert code == 1, output
    assert not psutil.wait_procs(family, timeout=3)[1]
    verify(out / RECORDING)
    assert archive.read(out).maps.steps(0)
    assert not (out / LIVE).exists()
    with viewer(out / RECORDING, "800x600") as client:
        assert not any(view.reports for view in client.get_state().views)


@pytest.mark.long
def test_a_viewer_that_is_terminated_keeps_its_recording(tmp_path: Path) -> None:
    out = tmp_path / "run"
    with swarm(out, "--view-as", "file") as process:
        wait_for_steps(out, process, 60_000)
        child(process, "view").terminate()
        code, output, _ = finish(process, 60)
    assert code == 0, output
    verify(out / RECORDING)
    assert archive.read(out).maps.steps(0)


@pytest.mark.parametrize("number", [signal.SIGSTOP, pytest.param(signal.SIGKILL, marks=pytest.mark.long)])
def test_a_viewer_that_hangs_or_dies_harms_nothing(number: int, tmp_path: Path) -> None:
    out = tmp_path / "run"
    with swarm(out, "--view-as", "file") as process:
        wait_for_steps(out, process, 60_000)
        victim = child(process, "view")
        victim.send_signal(number)
        code, output, _ = finish(process, 60)
    assert code == 0, output
    assert "the viewer failed, the run was not affected" in output
    assert not victim.is_running()
    assert summary(out)["finished"]
    verify(out / RECORDING)


def test_a_viewer_changes_no_digest_and_the_pace_is_kept(tmp_path: Path) -> None:
    began = time.monotonic()
    more = ["--steps", "40", "--view-as", "file", "--pictures", "--pace", "20"]
    with swarm(tmp_path / "shown", *more) as process:
        finish(process, 60)
    assert time.monotonic() - began > 40 / 20
    plain = explore(load(tmp_path / "shown" / "scenario.toml", {"bus": "memory"}), keep=False)
    assert plain.summary["digest"] == summary(tmp_path / "shown")["digest"]
    assert (tmp_path / "shown" / "pictures" / "maps-over-time.png").exists()


def test_a_viewer_can_attach_late_to_a_run_without_a_viewer(tmp_path: Path) -> None:
    out = tmp_path / "run"
    watch = [sys.executable, "-m", "deploy.commands.main", "watch", str(out), "--view-as", "file"]
    with swarm(out, "--pace", "2") as process:
        wait_for(out / LIVE, process)
        assert (out / LIVE).stat().st_mode & 0o077 == 0
        child(process, "r2")
        watching = subprocess.Popen(watch, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        wait_for(out / RECORDING, process, 10_000)
        process.terminate()
        finish(process, 60)
        _, errors = watching.communicate(timeout=60)
    assert watching.returncode == 0, errors
    verify(out / RECORDING)
    maps = archive.read(out).maps
    assert all(maps.steps(robot) for robot in range(3))


def test_watching_a_directory_without_a_recording_is_an_error(tmp_path: Path) -> None:
    watch = [sys.executable, "-m", "deploy.commands.main", "watch", str(tmp_path), "--view-as", "file"]
    done = subprocess.run(watch, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert "no recording (run.rrd)" in done.stderr
