"""The first run compiles kernels before its first step; the time for that is no part of the run's time."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]

STRATEGY = """
from agent.strategies.targets import TargetStrategy
from protocol.kernels import kernel


@kernel
def rounds(number: int) -> int:
    total = 0
    for first in range(number):
        for second in range(first):
            total += (first * second) % 7
    return total


class Late(TargetStrategy):
    name, summary, source = "late", "calls a kernel that is not in the cache", "our own"

    def choose(self, situation, goals, planner):
        rounds(3)
        x, y = goals[0]
        return int(x), int(y)
"""
RUN = """
import time
from murmur import explore
began = time.perf_counter()
run = explore(map="office", robots=2, steps=3, strategy="late:Late", bus="memory", keep=False)
elapsed_s = time.perf_counter() - began
from protocol.kernels import compilation_s
print(run.summary["lost"], run.summary["wall_s"], compilation_s(), elapsed_s)
"""


def test_the_time_of_a_run_does_not_contain_the_compilation_of_kernels(tmp_path: Path) -> None:
    (tmp_path / "late.py").write_text(STRATEGY)
    env = os.environ | {"PYTHONPATH": f"{tmp_path}:{ROOT}"}
    done = subprocess.run([sys.executable, "-c", RUN], capture_output=True, text=True, check=True, env=env)
    lost, *seconds = done.stdout.split()
    run_s, compilation_s, elapsed_s = map(float, seconds)
    assert lost == "{}"
    assert "compiling for this machine, once" in done.stderr
    assert compilation_s > 0
    assert run_s <= elapsed_s - compilation_s + 0.001


def murmur(cache: Path, *words: str) -> tuple[subprocess.CompletedProcess[str], float]:
    """Run a command with numba's cache in a directory; return its result, and the seconds that it took."""
    began = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "deploy.commands.main", *words],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(cache)},
    )
    return done, time.monotonic() - began


@pytest.mark.long
@pytest.mark.parametrize("bus", ["zenoh", "memory"])
def test_the_first_run_of_an_installation_compiles_with_progress_before_its_clock_starts(
    tmp_path: Path, bus: str
) -> None:
    words = (
        "explore",
        "--robots",
        "2",
        "--steps",
        "30",
        "--bus",
        bus,
        "--json",
        "--out",
        str(tmp_path / "run"),
    )
    first, took_s = murmur(tmp_path / "cache", *words)
    assert first.returncode == 1, first.stderr
    lines = first.stderr.splitlines()
    counts = [re.match(r"compiling for this machine, once: (\d+) of \d+ kernels", line) for line in lines]
    done = [int(count[1]) for count in counts if count]
    assert len(done) > 5
    assert done == sorted(done)
    assert re.match(r"compiled \d+ kernels", lines[len(done)])
    assert json.loads(first.stdout)["wall_s"] < took_s / 2, "compilation takes most of the time"


@pytest.mark.long
def test_setup_compiles_all_kernels_of_a_run(tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    first, _ = murmur(cache, "setup")
    assert first.returncode == 0, first.stderr
    assert "kernels: " in first.stdout
    assert str(cache) in first.stdout
    assert "compiled" in first.stderr
    second, _ = murmur(cache, "setup")
    assert (second.returncode, second.stderr) == (0, "")
    assert " 0 of them compiled now" in second.stdout
    for bus in ("zenoh", "memory"):
        for more in ([], ["--thesis"], ["--laser", "utm-30lx", "--pose", "graph-slam", "--people", "2"]):
            out = str(tmp_path / f"{bus}{len(more)}")
            run, _ = murmur(
                cache, "explore", "--robots", "2", "--steps", "20", "--bus", bus, "--out", out, *more
            )
            assert "compil" not in run.stderr
