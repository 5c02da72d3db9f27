"""Parallel runs in a local pool or on a cluster: each run is executed once, even if processes die."""

from __future__ import annotations

import importlib
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from deploy.run import fork_server
from deploy.run.workers import DIED, Cluster, LocalPool

ROOT = Path(__file__).parents[3]


@dataclass(frozen=True)
class Number:
    key: str

    @property
    def value(self) -> int:
        return int(self.key)


@dataclass(frozen=True)
class Named:
    key: str


def square(number: Number) -> int:
    return number.value**2


def dies_at_2(number: Number) -> int:
    if number.value == 2:
        os._exit(1)
    return square(number)


def waits_unless_it_is_1(number: Number) -> int:
    if number.value > 1:
        time.sleep(60)
    return square(number)


def numbers(*values: int) -> list[Number]:
    return [Number(str(value)) for value in values]


def test_each_case_has_its_outcome_once() -> None:
    outcomes = list(LocalPool(2).each(numbers(3, 4, 5), square))
    assert sorted((case.value, outcome) for case, outcome in outcomes) == [(3, 9), (4, 16), (5, 25)]


def test_process_that_dies_fails_its_own_run_only() -> None:
    outcomes = dict(LocalPool(2).each(numbers(1, 2, 3, 4), dies_at_2))
    assert outcomes == dict(zip(numbers(1, 2, 3, 4), (1, DIED, 9, 16), strict=True))


def process(number: Number) -> int:
    del number
    return os.getpid()


def test_process_that_dies_between_two_runs_fails_no_run() -> None:
    outcomes = []
    for _, worker in LocalPool(1).each(numbers(1, 2), process):
        outcomes.append(worker)
        (child,) = multiprocessing.active_children()
        os.kill(worker, signal.SIGKILL)
        child.join()
        time.sleep(0.5)
    assert len(set(outcomes)) == 2


def test_closing_the_iterator_ends_the_other_runs_at_once() -> None:
    began = time.monotonic()
    outcomes = LocalPool(2).each(numbers(1, 2, 3, 4), waits_unless_it_is_1)
    assert next(outcomes) == (Number("1"), 1)
    outcomes.close()  # type: ignore[attr-defined]
    while multiprocessing.active_children():
        assert time.monotonic() - began < 30
        time.sleep(0.05)


def test_ctrl_c_ends_the_wait_for_a_long_run_at_once() -> None:
    importlib.import_module("polars")  # which changes the handling of signals
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        for _ in LocalPool(2).each(numbers(1, 2), waits_unless_it_is_1):
            threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
    assert time.monotonic() - began < 30


def test_error_names_an_unreachable_scheduler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Cluster, "REPLY_TIMEOUT_S", 1)
    with pytest.raises(ValueError, match=r"scheduler = 'tcp://127.0.0.1:9': .*give its address"):
        Cluster("tcp://127.0.0.1:9")


def test_threads_have_studies_of_their_own() -> None:
    main = sys.modules["__main__"]
    outcomes: list[int | str] = []

    def study(value: int) -> None:
        outcomes.extend(outcome for _, outcome in LocalPool(1).each(numbers(value), square))

    threads = [threading.Thread(target=study, args=(value,)) for value in range(5)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(map(int, outcomes)) == [0, 1, 4, 9, 16]
    assert sys.modules["__main__"] is main


def test_closing_one_study_leaves_the_processes_of_another_alone() -> None:
    closed, other = (LocalPool(1).each(numbers(1, 2, 3), process) for _ in range(2))
    next(closed)
    _, worker = next(other)
    closed.close()  # type: ignore[attr-defined]
    assert [pid for _, pid in other] == [worker, worker]


def environment(name: Named) -> str | None:
    return os.environ.get(name.key)


def test_studies_outlive_the_fork_server_and_have_the_current_environment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("MURMUR_TEST", "first")
    pool, todo = LocalPool(1), [Named("MURMUR_TEST")]
    list(pool.each(todo, environment))
    server = fork_server.pid()
    assert server is not None
    os.kill(server, signal.SIGKILL)
    os.waitid(os.P_PID, server, os.WEXITED | os.WNOWAIT)
    assert list(pool.each(todo, environment)) == [(todo[0], "first")]
    monkeypatch.setenv("MURMUR_TEST", "second")
    assert list(pool.each(todo, environment)) == [(todo[0], "second")]
    monkeypatch.delenv("MURMUR_TEST")
    assert list(pool.each(todo, environment)) == [(todo[0], None)]


def test_error_names_a_deleted_current_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    with pytest.raises(FileNotFoundError, match="current directory has been deleted"):
        list(LocalPool(1).each(numbers(1), square))


def slow_square(number: Number) -> tuple[int, int]:
    time.sleep(0.2)
    return os.getpid(), square(number)


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[str]:
    """A scheduler and two workers as processes on loopback; the scheduler's address."""
    pytest.importorskip("distributed")
    file = tmp_path / "scheduler.json"
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "DASK_DISTRIBUTED__WORKER__DAEMON": "False"}

    def start(*arguments: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-m", *arguments], cwd=tmp_path, env=environment,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip

    own = ["--host", "127.0.0.1", "--no-dashboard"]
    started = [start("distributed.cli.dask_scheduler", *own, "--port", "0", "--scheduler-file", str(file))]
    try:
        worker = ["distributed.cli.dask_worker", *own, "--nthreads", "1", "--no-nanny"]
        started += [start(*worker, "--scheduler-file", str(file)) for _ in range(2)]
        while not file.exists() or not file.read_text().endswith("}"):
            assert started[0].poll() is None
            time.sleep(0.1)
        yield json.loads(file.read_text())["address"]
    finally:
        for process in started:
            process.kill()
            process.wait()


def test_killed_cluster_worker_loses_no_run_and_repeats_none(cluster: str) -> None:
    todo = numbers(*range(20))
    outcomes, killed = [], None
    for case, outcome in Cluster(cluster).each(todo, slow_square):
        assert isinstance(outcome, tuple), outcome
        if killed is None:
            killed = outcome[0]
            os.kill(killed, signal.SIGKILL)
        outcomes.append((case.value, outcome[1]))
    assert sorted(outcomes) == [(n, n * n) for n in range(20)]
