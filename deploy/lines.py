"""Many runs and their outcomes: a JSON line each as soon as it is known; what is known is not run again."""

from __future__ import annotations

import json
from collections.abc import Callable, Hashable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Protocol, TypeVar


class Keyed(Protocol):
    """A case, or the outcome that it has led to."""

    @property
    def key(self) -> Hashable:
        """What a case and its outcome have in common, and no other has."""


Case = TypeVar("Case", bound=Keyed)
Outcome = TypeVar("Outcome", bound=Keyed)


def collect(
    todo: Sequence[Case], run: Callable[[Case], Outcome], kind: type[Outcome], jobs: int, file: Path | None
) -> Iterator[Outcome]:
    """Give the outcomes of all cases, first those that `file` knows, then the others as they are known.

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
        Where outcomes are kept, a JSON object a line.
    """
    known = {outcome.key: outcome for outcome in read(file, kind)} if file is not None else {}
    yield from (known[case.key] for case in todo if case.key in known)
    with ProcessPoolExecutor(jobs) as pool:
        waiting = [pool.submit(run, case) for case in todo if case.key not in known]
        for future in as_completed(waiting):
            outcome = future.result()
            if file is not None:
                with file.open("a", encoding="utf-8") as lines:
                    lines.write(json.dumps(vars(outcome)) + "\n")
            yield outcome


def read(file: Path, kind: type[Outcome]) -> list[Outcome]:
    """Read the outcomes that a file holds; none if it is not there yet."""
    if not file.exists():
        return []
    return [kind(**json.loads(line)) for line in file.read_text(encoding="utf-8").splitlines()]
