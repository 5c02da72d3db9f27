"""Many runs and their outcomes: one JSON line each as soon as it is known; known outcomes are not run again."""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Hashable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Protocol, TextIO, TypeVar


class Keyed(Protocol):
    """A case, or its outcome."""

    @property
    def key(self) -> Hashable:
        """What a case and its outcome have in common, and no other has."""


Case = TypeVar("Case", bound=Keyed)
Outcome = TypeVar("Outcome", bound=Keyed)


def collect(
    todo: Sequence[Case], run: Callable[[Case], Outcome], kind: type[Outcome], jobs: int, file: Path | None
) -> Iterator[Outcome]:
    """Yield the outcomes of all cases, first those in `file`, then the others as they become known.

    Anything that ends it early, Ctrl-C or a failing run, ends the processes immediately; the file keeps its lines.

    Parameters
    ----------
    todo : sequence of cases
    run : callable
        Runs a case, in a process of a pool.
    kind : type
        The dataclass of its outcomes.
    jobs : int
        Processes.
    file : Path, optional
        Where outcomes are kept, one JSON object per line.

    Raises
    ------
    ValueError
        The file cannot be written, or has other content; nothing has been run.
    """
    known = {outcome.key: outcome for outcome in read(file, kind)} if file is not None else {}
    with _processes(jobs) as pool, _opened(file) as lines:
        yield from (known[case.key] for case in todo if case.key in known)
        waiting = [pool.submit(run, case) for case in todo if case.key not in known]
        for future in as_completed(waiting):
            outcome = future.result()
            if lines is not None:
                lines.write(json.dumps(vars(outcome)) + "\n")
            yield outcome


def read(file: Path, kind: type[Outcome]) -> list[Outcome]:
    """Read the outcomes in a file; none if it does not exist yet; ValueError if it has other content."""
    outcomes = []
    with _named(file):
        text = file.read_text(encoding="utf-8") if file.exists() else ""
    for number, line in enumerate(text.splitlines(), 1):
        try:
            outcomes.append(kind(**json.loads(line)))
        except (TypeError, ValueError):
            raise ValueError(
                f"out = {file}: line {number} is no outcome of such runs; name a new file, or delete that line"
            ) from None
    return outcomes


@contextlib.contextmanager
def _opened(file: Path | None) -> Iterator[TextIO | None]:
    """A file to which lines are added, each on the disk as soon as it is written."""
    if file is None:
        yield None
        return
    with _named(file):
        lines = file.open("a", buffering=1, encoding="utf-8")
    with lines:
        yield lines


@contextlib.contextmanager
def _named(file: Path) -> Iterator[None]:
    """Turn what is wrong with the file into a message."""
    try:
        yield
    except OSError as error:
        raise ValueError(f"out = {file}: {error.strerror}; name a file that can be written") from None
    except UnicodeDecodeError:
        raise ValueError(f"out = {file}: holds no text; name a new file") from None


@contextlib.contextmanager
def _processes(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """A pool whose processes end immediately if the work is aborted."""
    others = multiprocessing.active_children()
    pool = ProcessPoolExecutor(jobs, initializer=_begin)
    try:
        yield pool
    except BaseException:
        for process in multiprocessing.active_children():
            if process not in others:
                process.terminate()
        pool.shutdown(cancel_futures=True)
        raise
    pool.shutdown()


def _begin() -> None:
    """Leave Ctrl-C to the parent process, and do not outlive it if it is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
