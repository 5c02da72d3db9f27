"""Kinds of robot faults, and checks of a schedule of them (docs/reliability.md). `FaultEvent` is one fault.

death     the robot breaks down and hands in its maps; the world removes it
kill      the robot's process is killed and loses its state; the world removes it
restart   the robot starts again where it was killed, with its journal only; a running robot is killed first
stop      the robot neither moves nor senses, sends or receives for some steps; then it continues
mute      the robot's radio cannot send
deaf      the robot's radio cannot receive
"""

from __future__ import annotations

import math
from bisect import insort
from collections import Counter
from collections.abc import Container, Iterable
from typing import Literal, get_args

from protocol.messages import FaultEvent

Kind = Literal["death", "kill", "restart", "stop", "mute", "deaf"]
KINDS: tuple[Kind, ...] = get_args(Kind)

RADIO_KINDS = ("mute", "deaf")
"""Kinds that affect only a robot's radio; the relay applies them, and the world all others."""

TEMPORARY = ("stop", *RADIO_KINDS)
"""Kinds of fault that may end by themselves."""


class FaultSchedule:
    """The faults of a run that have not occurred yet, and the temporary faults that are active."""

    def __init__(self, faults: Iterable[FaultEvent]) -> None:
        self.pending = sorted(faults)
        """Faults that have not occurred yet, by step."""
        self.active: dict[str, dict[int, float]] = {kind: {} for kind in TEMPORARY}
        """For each kind in `TEMPORARY`: the affected robots, each with the step in which it recovers (inf: never)."""

    def add(self, fault: FaultEvent) -> None:
        """Schedule one more fault."""
        insort(self.pending, fault)

    def due(self, step: int, present: Container[int]) -> list[FaultEvent]:
        """Remove and return the faults of `step`, in order, and update `active`; only `present` robots can stop."""
        due = [fault for fault in self.pending if fault.step <= step]
        self.pending = [fault for fault in self.pending if fault.step > step]
        for robots in self.active.values():
            for robot in [robot for robot, until in robots.items() if until <= step]:
                del robots[robot]
        for fault in due:
            if fault.kind in TEMPORARY and (fault.kind != "stop" or fault.robot in present):
                self.active[fault.kind][fault.robot] = step + fault.steps if fault.steps else math.inf
        return due


def check(faults: Iterable[FaultEvent], robots: int) -> None:
    """Raise ValueError if a fault names an unknown robot or kind, or a robot that is gone by then."""
    gone: dict[int, str] = {}
    last: dict[tuple[int, str], FaultEvent] = {}
    for fault in sorted(faults):
        where = f"fault at step {fault.step}: {fault.kind} of robot {fault.robot}"
        if not 0 <= fault.robot < robots:
            raise ValueError(f"{where}: the last robot is {robots - 1}")
        if fault.kind not in KINDS:
            raise ValueError(f"{where}: kind must be one of {', '.join(KINDS)}")
        if fault.steps and fault.kind not in TEMPORARY:
            raise ValueError(f"{where}: steps = {fault.steps}, but only {', '.join(TEMPORARY)} are temporary")
        affected = fault.robot, fault.kind if fault.kind in RADIO_KINDS else "body"
        before = last.get(affected)
        if before is not None and before.step == fault.step:
            raise ValueError(f"{where}: it has {before.kind} in the same step")
        last[affected] = fault
        if fault.kind in RADIO_KINDS:
            continue
        how = gone.get(fault.robot)
        if how == "death" or (how == "kill" and fault.kind != "restart"):
            raise ValueError(f"{where}: it is gone by then ({how})")
        if fault.kind in ("death", "kill"):
            gone[fault.robot] = fault.kind
        else:
            gone.pop(fault.robot, None)


def incarnations(faults: Iterable[FaultEvent]) -> int:
    """Return how often a robot may start at most: once, and once more for each of its restarts."""
    counts = Counter(fault.robot for fault in faults if fault.kind == "restart")
    return 1 + max(counts.values(), default=0)
