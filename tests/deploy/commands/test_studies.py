"""`murmur sweep`: what it prints and keeps, and how it ends."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner

from deploy.commands.main import app
from tests.deploy.study.small_experiment import EXPERIMENT, write

MURMUR = [sys.executable, "-m", "deploy.commands.main"]


def command(*words: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, ["sweep", *map(str, words)])
    return result.exit_code, result.stdout, result.stderr


def test_the_command_prints_the_table_and_keeps_a_summary_a_line(tmp_path: Path) -> None:
    path, out = write(tmp_path, EXPERIMENT), tmp_path / "all.jsonl"
    code, table, _ = command(path, "--jobs", 1, "--set", "robots=1", "--set", "seed=0", "--out", out)
    assert code == 0 and "steps bytes.total, means of 2 runs" in table
    lines = [json.loads(line) for line in out.read_text().splitlines()]
    assert {line["place"]["variant"] for line in lines} == {"polygons", "scans"}
    assert all(line["summary"]["steps"] == 6 for line in lines)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--out", "/nonexist/a.jsonl"], "out = /nonexist/a.jsonl: No such file or directory"),
        (["--set", "map=nope"], "no environment is called 'nope'"),
        (
            ["--set", "seed=0", "--set", "seed=1"],
            "set = 'seed=1': seed is given twice; give it once, as seed=[0,1]",
        ),
        (["--set", "seed"], "set = 'seed': must be NAME=VALUE, as seed=[0,1]"),
    ],
)
def test_bad_input_is_refused_before_the_first_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], said: str
) -> None:
    monkeypatch.setattr("deploy.study.run_pool.ProcessPoolExecutor.submit", None)
    code, table, errors = command(write(tmp_path, EXPERIMENT), *words)
    assert (code, table, errors.count("\n")) == (2, "", 1)
    assert said in errors


def begun(tmp_path: Path, out: Path) -> subprocess.Popen[str]:
    """A sweep of eight runs in a process group of its own, of which one at least is finished."""
    text = EXPERIMENT.replace("seed = [0, 1]", "seed = [0, 1]\nsteps = [1, 5000]").replace("steps = 6\n", "")
    path = write(tmp_path, text.replace('"em"', '"office"'))
    sweeping = subprocess.Popen(
        [*MURMUR, "sweep", path, "--jobs", "2", "--set", "robots=12", "--out", out],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])},
    )  # fmt: skip
    while not out.exists() or not out.read_text():
        assert sweeping.poll() is None
        time.sleep(0.1)
    return sweeping


def assert_none_is_left(group: int) -> None:
    deadline = time.monotonic() + 10
    with pytest.raises(ProcessLookupError):
        while time.monotonic() < deadline:
            os.killpg(group, 0)
            time.sleep(0.1)


def test_ctrl_c_stops_a_sweep_at_once_and_keeps_what_is_finished(tmp_path: Path) -> None:
    out = tmp_path / "all.jsonl"
    sweeping = begun(tmp_path, out)
    os.killpg(sweeping.pid, signal.SIGINT)
    asked = time.monotonic()
    table, errors = sweeping.communicate(timeout=30)
    assert sweeping.returncode == 130 and time.monotonic() - asked < 10
    assert_none_is_left(sweeping.pid)
    assert f"stopped; the same command continues from {out}" in errors and "Traceback" not in errors
    kept = len(out.read_text().splitlines())
    assert 0 < kept < 8 and f"means of {kept} of 8 runs" in table


def test_nothing_outlives_a_sweep_that_is_killed(tmp_path: Path) -> None:
    sweeping = begun(tmp_path, tmp_path / "all.jsonl")
    sweeping.kill()
    sweeping.communicate(timeout=30)
    assert_none_is_left(sweeping.pid)
