"""Faults: what befalls robots, and when, as data (docs/reliability.md).

death     it breaks down, hands in its maps, and its body is taken away
kill      its process is killed, with all that it knows; its body is taken away
restart   it begins anew, with its journal only, where it was killed; one that lives is killed before
stop      it stands still, senses, hears and says nothing; then goes on as if nothing had been
mute      its radio cannot send
deaf      its radio cannot hear
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

KINDS = ("death", "kill", "restart", "stop", "mute", "deaf")

LASTING = ("stop", "mute", "deaf")
"""Those that may pass."""


@dataclass(frozen=True, order=True)
class Fault:
    """One fault.

    Attributes
    ----------
    step : int
        At whose beginning it comes.
    robot : int
    kind : str
        One of `KINDS`.
    steps : int
        How many steps it lasts, for those that are `LASTING`; 0: for good.
    """

    step: int
    robot: int
    kind: str
    steps: int = 0


def check(faults: Iterable[Fault], robots: int) -> None:
    """Raise ValueError if a fault befalls a robot that does not exist, or is not there to have it."""
    gone: dict[int, str] = {}
    last: dict[int, Fault] = {}
    for fault in sorted(faults):
        where = f"fault at step {fault.step}: {fault.kind} of robot {fault.robot}"
        if not 0 <= fault.robot < robots:
            raise ValueError(f"{where}: the last robot is {robots - 1}")
        if fault.kind not in KINDS:
            raise ValueError(f"{where}: there are: {', '.join(KINDS)}")
        if fault.steps and fault.kind not in LASTING:
            raise ValueError(f"{where}: steps = {fault.steps}, but only {', '.join(LASTING)} may pass")
        before = last.get(fault.robot)
        if (
            before is not None
            and before.step == fault.step
            and not {before.kind, fault.kind} & {"mute", "deaf"}
        ):
            raise ValueError(f"{where}: {before.kind} befalls it in the same step")
        if fault.kind in ("mute", "deaf"):
            continue
        last[fault.robot] = fault
        how = gone.get(fault.robot)
        if how == "death" or (how == "kill" and fault.kind != "restart"):
            raise ValueError(f"{where}: it is gone by then ({how})")
        if fault.kind in ("death", "kill"):
            gone[fault.robot] = fault.kind
        else:
            gone.pop(fault.robot, None)


def deafen(faults: Iterable[Fault]) -> bool:
    """Whether a robot may go deaf: those who broadcast cannot notice."""
    return any(fault.kind == "deaf" for fault in faults)


def incarnations(faults: Iterable[Fault]) -> int:
    """How often a robot begins, at most: once, and once more with each restart."""
    counts: dict[int, int] = {}
    for fault in faults:
        if fault.kind == "restart":
            counts[fault.robot] = counts.get(fault.robot, 0) + 1
    return 1 + max(counts.values(), default=0)
