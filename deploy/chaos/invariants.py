"""Invariants of every swarm under any faults: checked for each robot in each step, and at the end of a run.

In each step, for each honest robot in its current incarnation:

- Its own grid agrees with the world in every known cell.
- It never loses a known cell of its own grid, and its planning grid agrees with its own grid in these cells.
- The logs of its teammates' maps never become shorter, unless it may have dropped forged or damaged entries.

At the end:

- The run has ended by itself, after a robot finished its exploration.
- The living robots together know at least `MIN_KNOWN` of the reachable cells.
- No step has carried more than its budget. Each transmitted byte was delivered or truncated, and each delivered unicast
  byte was received once.
- If a robot's map is false, the maps of others have at most `MAX_WRONG` wrong cells where honest robots were.
- Without byzantine robots and damaged frames, each log that a robot holds of another incarnation agrees with the log
  written there.
"""

from __future__ import annotations

import numpy as np

from agent.robot import Robot
from deploy.record.records import Records
from deploy.record.summary import summarize
from deploy.scenario.plan import Plan
from netshaper.ledger import balance
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid

MIN_KNOWN = 0.97
"""Share of the reachable free cells that the living robots must know at the end."""

MAX_WRONG = 100
"""Wrong cells in a robot's planning grid at the end that a false map may cause, where honest robots have been."""


class InvariantError(AssertionError):
    """An invariant is violated; the message names the robot, the step and the values."""


class InvariantChecker:
    """Checks a run robot by robot while it goes on.

    There are no guarantees for robots in `byzantine`. `lying` is a robot whose map is false. `damaged`: whether robots
    may receive damaged frames.
    """

    def __init__(
        self, plan: Plan, byzantine: tuple[int, ...], lying: int | None = None, *, damaged: bool = False
    ) -> None:
        self.known = 0.0
        """Share of the reachable free cells that the living robots know at the end."""
        self._plan = plan
        self._byzantine = byzantine
        self._lying = lying
        self._logs_are_true = not byzantine and not damaged
        self._truth: Grid = np.where(plan.map.cells == FREE, FREE, OCCUPIED).astype(np.uint8)
        self._incarnations: dict[tuple[int, int], Robot] = {}
        self._checked: dict[int, tuple[Robot, int]] = {}
        """The current incarnation of each robot, and its last checked step."""
        self._own: dict[int, Grid] = {}
        self._lengths: dict[int, list[int]] = {}

    def check(self, step: int, robot: Robot) -> None:
        """Check a robot once per step, at the end of the step; InvariantError if an invariant is violated."""
        number = robot.settings.robot
        previous, last = self._checked.get(number, (None, -1))
        if number in self._byzantine or (previous is robot and last == step):
            return
        self._incarnations[number, robot.settings.incarnation] = robot
        self._checked[number] = robot, step
        lengths = [len(log) for log in robot.replication.logs]
        name = f"step {step}: robot {number}"
        known = robot.own != UNKNOWN
        if (robot.own != self._truth)[known].any():
            raise InvariantError(f"{name}: own grid differs from the world")
        if step and (robot.planning != robot.own)[known].any():
            raise InvariantError(f"{name}: planning grid differs from own grid")
        if previous is robot:
            if (robot.own == UNKNOWN)[self._own[number] != UNKNOWN].any():
                raise InvariantError(f"{name}: a known cell has become unknown")
            for map_id, (before, now) in enumerate(zip(self._lengths[number], lengths, strict=True)):
                if now < before and map_id != robot.settings.own_map and self._logs_are_true:
                    raise InvariantError(f"{name}: log of map {map_id} shrank from {before} to {now} entries")
        self._own[number], self._lengths[number] = robot.own.copy(), lengths

    def check_end(self, records: Records) -> None:
        """Check the end of a run; InvariantError if an invariant is violated."""
        summary = summarize(self._plan, records, 1.0)
        if not summary["finished"]:
            raise InvariantError(f"no robot finished: the run ended with {summary['reason']!r}")
        if records.lost:
            raise InvariantError(f"robots were lost: {records.lost}")
        if summary["over_budget_steps"]:
            raise InvariantError(f"{summary['over_budget_steps']} steps carried more than the budget")
        self._check_accounting(records)
        reachable = self._plan.reachable
        honest = [grid for robot, grid in records.planning.items() if robot not in self._byzantine]
        if honest:
            known = np.logical_or.reduce([grid == FREE for grid in honest]) & reachable
            self.known = float(known.sum() / reachable.sum())
            if self.known < MIN_KNOWN:
                raise InvariantError(f"the living robots know {self.known:.3f} of the world, not {MIN_KNOWN}")
        if self._lying is not None:
            self._check_lies(records)
        if self._logs_are_true:
            self._check_logs()

    def _check_lies(self, records: Records) -> None:
        """Check that honest robots believe few lies about cells that one of them knows."""
        honest = records.planning.keys() - {self._lying}
        seen = np.logical_or.reduce([records.own[robot] != UNKNOWN for robot in honest])
        for robot in honest:
            grid = records.planning[robot]
            wrong = np.count_nonzero(seen & (grid != UNKNOWN) & (grid != self._truth))
            if wrong > MAX_WRONG:
                raise InvariantError(f"robot {robot} believes robot {self._lying} in {wrong} wrong cells")

    def _check_accounting(self, records: Records) -> None:
        rows = records.ledger()
        for step, (sent, carried, cut, received) in balance(rows).items():
            unicast = (rows["step"] == step) & (rows["receiver"] >= 0) & (rows["carried"] == 1)
            unicast_bytes = int(rows["bytes"][unicast].sum())
            if sent != carried + cut or (received != unicast_bytes and self._plan.radio.perfect):
                raise InvariantError(
                    f"step {step}: {sent} bytes sent, {carried} carried, {cut} truncated; "
                    f"{received} of {unicast_bytes} unicast bytes received"
                )

    def _check_logs(self) -> None:
        """Check that each log that a robot holds agrees with the log of its author."""
        robots = self._plan.scenario.robots
        for (number, incarnation), robot in self._incarnations.items():
            for map_id, log in enumerate(robot.replication.logs):
                author = self._incarnations.get((map_id % robots, map_id // robots))
                if author is None or author is robot:
                    continue
                written = author.replication.logs[map_id]
                held = log.read(0)
                if held != written.read(0)[: len(held)]:
                    raise InvariantError(
                        f"robot {number}, incarnation {incarnation}: log of map {map_id} differs from its author's"
                    )
