"""The order in which a dashboard processes reports: whole steps, one after the other.

The bus keeps the order of the messages of one sender, but not between senders: the radio's report of a step may arrive
after the world has reported the next one, and robots report their targets after the world has reported their positions.
`StepOrder` holds the reports of a step back until all are there, so that a picture shows one step only.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from protocol import keys as names
from protocol.messages import (
    Change,
    ErrorReport,
    FaultEvent,
    Lost,
    Missed,
    Outlines,
    RadioReport,
    RobotStatus,
    Shutdown,
    Snapshot,
    WorldReport,
)

Report = tuple[str, object]
"""A sender and its report."""

LONGEST_WAIT = 2
"""Number of further steps that the world may report before an incomplete step is processed as it is."""
_OF_A_STEP = Change | FaultEvent | Missed | Outlines | RadioReport | RobotStatus | Snapshot | WorldReport
_FIRST: dict[type, int] = {Change: 0, FaultEvent: 0, WorldReport: 1, RadioReport: 2}
"""The order of the reports that precede all others of their step."""


@dataclass
class StepReports:
    """The reports of one step, in the order in which they should be processed."""

    step: int
    reports: list[Report] = field(default_factory=list)
    has_world: bool = False
    """Whether the report of the world is among them, so that the step can be drawn."""


@dataclass
class _Open:
    """A step that is incomplete."""

    arrived: list[Report] = field(default_factory=list)
    missing: set[str] | None = None
    """Robots whose status has not arrived; None before the report of the world."""
    has_radio: bool = False
    reported: set[str] = field(default_factory=set)
    """Robots whose status has arrived."""
    late: set[str] = field(default_factory=set)
    """Robots that have missed a phase of the step, by the wall clock."""

    def is_complete(self, without: set[str]) -> bool:
        """Whether all reports are there, except those of some robots."""
        return (
            self.missing is not None
            and self.has_radio
            and self.missing <= without | self.reported | self.late
        )

    def in_order(self) -> list[Report]:
        """All reports: those of the world and the radio first."""
        return sorted(self.arrived, key=lambda each: _FIRST.get(type(each[1]), len(_FIRST)))


class StepOrder:
    """Collects reports, and returns those of each step together once the step is complete."""

    def __init__(self) -> None:
        self._open: dict[int, _Open] = {}
        self._done = 0
        """The last step that was returned."""
        self._newest = 0
        """The last step that the world has reported."""
        self._lost: set[str] = set()

    def put(self, sender: str, report: object) -> list[StepReports]:
        """Take a report; return the steps that are complete now, in order.

        Errors, and reports of a step that was returned before, are returned at once, and so are those without a step
        while no step is open. Others without a step belong to the last open one. `Shutdown` completes all steps. Of a
        robot, one status per step counts, and no step after the next one of the world.
        """
        step = report.step if isinstance(report, _OF_A_STEP) else max(self._open, default=self._done)
        if names.is_robot(sender):
            step = min(step, self._newest + 1)
        if step <= self._done or isinstance(report, ErrorReport):
            return [StepReports(min(step, self._done), [(sender, report)])]
        here = self._open.setdefault(step, _Open())
        if isinstance(report, RobotStatus) and sender in here.reported:
            return []
        here.arrived.append((sender, report))
        self._note(step, sender, report)
        if isinstance(report, Shutdown):
            return self.finish()
        overdue = [each for each in sorted(self._open) if each <= self._newest - LONGEST_WAIT]
        done = self._take(overdue)
        while self._open and self._open[min(self._open)].is_complete(self._lost):
            done += self._take([min(self._open)])
        return done

    def finish(self) -> list[StepReports]:
        """Return all steps that are left, complete or not."""
        return self._take(sorted(self._open))

    def _note(self, step: int, sender: str, report: object) -> None:
        """Note which reports of a step are there."""
        here = self._open[step]
        if isinstance(report, WorldReport):
            robots = report.pose_rows[:, 0].tolist()
            here.missing = set(map(names.robot, robots))
            self._newest = max(self._newest, step)
            self._lost -= here.missing
        elif isinstance(report, RadioReport):
            here.has_radio = True
        elif isinstance(report, RobotStatus):
            here.reported.add(sender)
        elif isinstance(report, Missed):
            here.late.update(map(names.robot, report.robots))
        elif isinstance(report, Lost):
            self._lost.add(names.robot(report.robot))

    def _take(self, steps: Iterable[int]) -> list[StepReports]:
        taken = []
        for step in steps:
            here = self._open.pop(step)
            self._done = max(self._done, step)
            taken.append(StepReports(step, here.in_order(), here.missing is not None))
        return taken
