"""radio.pcapng as a file: the same on both buses, and there to be opened however a run ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow.parquet
import pytest

from deploy.record import run_directory
from deploy.run.exploration import explore
from deploy.run.result import Result
from deploy.scenario.scenario import parse
from netshaper import capture
from netshaper.capture import Captured
from netshaper.pcapng import Reader

ROOT = Path(__file__).parents[2]
SETTINGS: dict[str, Any] = {"robots": 3, "bandwidth": 500, "range": "50%", "steps": 40, "seed": 3}
PATIENCE_S = 60


def read(run: Path) -> tuple[list[Captured], int]:
    with (run / run_directory.CAPTURE).open("rb") as file:
        reader = Reader(file)
        return list(capture.read(reader)), reader.torn


@pytest.fixture(scope="module")
def on_both(tmp_path_factory: pytest.TempPathFactory) -> list[Result]:
    folder = tmp_path_factory.mktemp("runs")
    return [explore(parse({**SETTINGS, "bus": bus}), out=folder / bus) for bus in ("memory", "zenoh")]


@pytest.fixture
def running(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[bytes], Path]]:
    """A run of processes that has sent some frames, and its run directory."""
    run = tmp_path / "run"
    arguments = ["explore", "--robots", "3", "--bandwidth", "500", "--steps", "100000", "--out", str(run)]
    with subprocess.Popen(
        [sys.executable, "-m", "deploy.commands.main", *arguments],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as swarm:
        deadline = time.monotonic() + PATIENCE_S
        file = run / run_directory.CAPTURE
        while not (file.exists() and file.stat().st_size > 20_000):
            assert swarm.poll() is None, "the run ended before its time"
            assert time.monotonic() < deadline, "the capture does not grow"
            time.sleep(0.02)
        yield swarm, run
        if swarm.poll() is None:
            swarm.kill()


def test_the_file_is_the_same_on_both_buses(on_both: list[Result]) -> None:
    memory, zenoh = (result.directory for result in on_both)
    assert memory is not None
    assert zenoh is not None
    assert (memory / run_directory.CAPTURE).read_bytes() == (zenoh / run_directory.CAPTURE).read_bytes()
    assert len(read(memory)[0]) > 100


def test_the_digest_is_the_same_on_both_buses(on_both: list[Result]) -> None:
    memory, zenoh = (result.summary for result in on_both)
    assert memory["digest"] == zenoh["digest"]


def test_a_run_ended_by_sigterm_leaves_a_whole_capture(
    running: tuple[subprocess.Popen[bytes], Path],
) -> None:
    swarm, run = running
    swarm.send_signal(signal.SIGTERM)
    swarm.wait(PATIENCE_S)
    frames, torn = read(run)
    assert torn == 0
    ledger = pyarrow.parquet.read_table(run / run_directory.LEDGER).to_pydict()
    assert sum(frame.size for frame in frames) == sum(ledger["bytes"])
    assert frames[-1].step == max(ledger["step"])


def test_a_run_that_is_killed_leaves_a_capture_that_opens(
    running: tuple[subprocess.Popen[bytes], Path],
) -> None:
    swarm, run = running
    before, _ = read(run)
    swarm.kill()
    swarm.wait(PATIENCE_S)
    frames, _ = read(run)
    assert frames[: len(before)] == before
    assert frames[-1].step >= before[-1].step
