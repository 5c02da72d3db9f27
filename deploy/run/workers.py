"""Parallel execution of runs by processes on this machine or by a Dask cluster; each run gives one outcome.

A run whose process dies counts as failed; the others continue. On this machine, the runs that were in progress when a
process died are repeated one at a time, to find the run that caused it. A cluster retries such a run a few times on
other workers.
"""

from __future__ import annotations

import contextlib
import os
import re
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any, Protocol, TypeVar

from deploy.run import fork_server
from deploy.run.parent_watchdog import end_with_parent
from deploy.run.process_table import load_fork_server
from protocol.packages import require


class Keyed(Protocol):
    """A case."""

    @property
    def key(self) -> str:
        """Its unique name."""


Case = TypeVar("Case", bound=Keyed)
Outcome = TypeVar("Outcome")

DIED = "its process died"


class Workers(Protocol):
    """Executors of runs."""

    def each(
        self, todo: Sequence[Case], run: Callable[[Case], Outcome]
    ) -> Iterator[tuple[Case, Outcome | str]]:
        """Yield each case with its outcome as soon as it is known, or with an error text.

        KeyboardInterrupt, or closing the iterator, ends the runs in progress immediately.
        """


class LocalPool:
    """A pool of `jobs` processes on this machine."""

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs

    def each(
        self, todo: Sequence[Case], run: Callable[[Case], Outcome]
    ) -> Iterator[tuple[Case, Outcome | str]]:
        """Yield each case with its outcome."""
        _heed_ctrl_c()
        if todo:
            load_fork_server()
        waiting = deque(todo)
        while waiting:
            suspects = []
            with _processes(min(self._jobs, len(waiting))) as pool:
                running: dict[Future[Outcome], Case] = {}
                while waiting or running:
                    with contextlib.suppress(BrokenProcessPool):
                        while waiting and len(running) < self._jobs:
                            running[_submit(pool, run, waiting[0])] = waiting[0]
                            waiting.popleft()
                    if not running:
                        break  # a process without a run died: continue with a new pool
                    over, _ = wait(running, return_when=FIRST_COMPLETED)
                    broken = False
                    for future in over:
                        case = running.pop(future)
                        if isinstance(future.exception(), BrokenProcessPool):
                            suspects.append(case)
                            broken = True
                        else:
                            yield case, future.result()
                    if broken:
                        suspects += running.values()
                        break
            for case in suspects:
                yield case, self._alone(case, run)

    @staticmethod
    def _alone(case: Case, run: Callable[[Case], Outcome]) -> Outcome | str:
        with _processes(1) as pool:
            try:
                return _submit(pool, run, case).result()
            except BrokenProcessPool:
                return DIED


class Cluster:
    """The workers of a Dask cluster, whose scheduler is at `address`; their number may change.

    Raises ValueError if no scheduler answers there, MissingPackageError if dask.distributed is not installed.
    """

    REPLY_TIMEOUT_S = 20

    def __init__(self, address: str) -> None:
        require("distributed", "cluster", "a scheduler needs")
        from distributed import Client  # noqa: PLC0415  an extra, and slow to import

        if not re.fullmatch(r"\w+://.+|\S+:[0-9]+", address):
            raise ValueError(f"scheduler = {address!r}: must be its address, as tcp://10.0.0.1:8786")
        try:
            self._client: Any = Client(address, timeout=self.REPLY_TIMEOUT_S, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise ValueError(
                f"scheduler = {address!r}: {str(error) or 'no scheduler answers'}; give its address, as tcp://10.0.0.1:8786"
            ) from None

    def each(
        self, todo: Sequence[Case], run: Callable[[Case], Outcome]
    ) -> Iterator[tuple[Case, Outcome | str]]:
        """Yield each case with its outcome."""
        from distributed import as_completed  # noqa: PLC0415

        _heed_ctrl_c()
        asked = {
            self._client.submit(
                _one_at_a_time, run, case, key=f"{case.key}-{os.getpid()}-{id(todo)}", pure=False
            ): case
            for case in todo
        }
        try:
            for future in as_completed(asked, loop=self._client.loop):
                case = asked[future]
                if future.status == "finished":
                    yield case, future.result()
                elif future.status == "error":
                    error = future.exception()
                    died = type(error).__name__ == "KilledWorker"
                    yield case, f"{DIED}, on several workers" if died else f"{type(error).__name__}: {error}"
                else:
                    raise ConnectionAbortedError(None, "the scheduler has ended, or has dropped the runs")
                future.release()
        finally:
            self._client.cancel(list(asked), force=True)
            self._client.close()


def workers(jobs: int | None, scheduler: str | None) -> Workers:
    """Return a cluster's workers if its scheduler is given, else `jobs` processes, by default one per core.

    Raises ValueError if `jobs` is not a number of processes.
    """
    if jobs is not None and jobs < 1:
        raise ValueError(f"jobs = {jobs}: must be a number of processes, at least 1")
    return LocalPool(jobs or os.cpu_count() or 1) if scheduler is None else Cluster(scheduler)


def _heed_ctrl_c() -> None:
    """Make Ctrl-C interrupt waiting for runs at once, which importing polars prevents."""
    signal.siginterrupt(signal.SIGINT, True)


_TURN = threading.Lock()


def _one_at_a_time(run: Callable[[Any], Any], case: Any) -> Any:
    """Execute a run in a worker; only one of its threads runs at a time."""
    with _TURN:
        return run(case)


def _submit(pool: ProcessPoolExecutor, run: Callable[[Case], Outcome], case: Case) -> Future[Outcome]:
    """Hand a run to a pool, which starts a process if none is idle."""
    with fork_server.starting():
        return pool.submit(run, case)


@contextlib.contextmanager
def _processes(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Return a pool whose processes end immediately on an exception."""
    pool = ProcessPoolExecutor(jobs, fork_server.context(), _begin, (dict(os.environ),))
    try:
        yield pool
    except BaseException:
        for process in list(pool._processes.values()):  # other threads may have pools of their own
            process.terminate()
        pool.shutdown(cancel_futures=True)
        raise
    pool.shutdown()


def _begin(environment: Mapping[str, str]) -> None:
    """Ignore Ctrl-C and SIGHUP, which the parent handles, and end with SIGTERM and with the parent.

    The environment is the parent's; that of the fork server may be older.
    """
    os.environ.clear()
    os.environ.update(environment)
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    end_with_parent(grace_s=0.0)
