"""`murmur sweep`: what it prints and keeps, and how it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import polars as pl
import pytest
from typer.testing import CliRunner

from deploy.commands.main import app
from tests.deploy.study.small_experiment import EXPERIMENT, write

MURMUR = [sys.executable, "-m", "deploy.commands.main"]


def command(*words: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, ["sweep", *map(str, words)])
    return result.exit_code, result.stdout, result.stderr


def test_the_command_prints_the_table_and_writes_runs_means_and_pictures(tmp_path: Path) -> None:
    plot = '[[plot]]\nkind = "curves"\ny = "explored"\n[[plot]]\nx = "robots"\ny = "steps"\n'
    path, out = write(tmp_path, EXPERIMENT + plot), tmp_path / "all.parquet"
    means, picture = tmp_path / "means.csv", tmp_path / "some.png"
    code, table, _ = command(
        path,
        "--jobs",
        1,
        "--set",
        "robots=1",
        "--set",
        "seed=0",
        "--out",
        out,
        "--table",
        means,
        "--plot",
        picture,
    )
    assert code == 0 and "steps bytes.total, means of 2 runs" in table
    assert pl.read_parquet(out)["steps"].to_list() == [6, 6]
    assert pl.read_csv(means)["variant"].to_list() == ["polygons", "polygons", "scans", "scans"]
    assert all(file.read_bytes()[1:4] == b"PNG" for file in (picture, tmp_path / "some-2.png"))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--out", "/nonexist/a.parquet"], "/nonexist/a.parquet: No such file or directory"),
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
    monkeypatch.setattr("deploy.study.workers.ProcessPoolExecutor.submit", None)
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
    while not out.exists() or not len(pl.read_parquet(out)):
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
    out = tmp_path / "all.parquet"
    sweeping = begun(tmp_path, out)
    os.killpg(sweeping.pid, signal.SIGINT)
    asked = time.monotonic()
    table, errors = sweeping.communicate(timeout=30)
    assert sweeping.returncode == 130 and time.monotonic() - asked < 10
    assert_none_is_left(sweeping.pid)
    assert f"stopped; the same command continues from {out}" in errors and "Traceback" not in errors
    kept = len(pl.read_parquet(out))
    assert 0 < kept < 8 and f"means of {kept} of 8 runs" in table


def test_nothing_outlives_a_sweep_that_is_killed(tmp_path: Path) -> None:
    sweeping = begun(tmp_path, tmp_path / "all.parquet")
    sweeping.kill()
    sweeping.communicate(timeout=30)
    assert_none_is_left(sweeping.pid)
