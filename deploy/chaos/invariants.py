"""What must hold of every swarm, whatever befalls it: checked of each robot in each step, and at the end.

In each step, of each honest robot in the life that it is in:

- its own grid says of no cell otherwise than the world is;
- what it has once known of its own it still knows, and its planning grid says the same of these cells;
- no log of a teammate's map becomes shorter: what it held at a save point it still holds.

At the end:

- the run has ended by itself, and a robot was done;
- of the cells that can be reached those that live know `ENOUGH` or more;
- no step has carried more than its budget; what was said was carried or cut, to the byte, and what was carried to one
  was heard once;
- where nobody lies: what a robot holds of a life's log is what was written in that life.
"""

from __future__ import annotations

import numpy as np

from agent.robot import Robot
from deploy.record.records import Records
from deploy.record.summary import summarize
from deploy.scenario.plan import Plan
from netshaper.ledger import balance
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid

ENOUGH = 0.97
"""Part of the reachable free cells that those who live know at the end."""


class Violation(AssertionError):  # noqa: N818  it is what it is called
    """Something that must hold does not: the message says what, of whom and when."""


class Watcher:
    """Checks a run as it goes, robot by robot.

    Parameters
    ----------
    plan : Plan
    liars : tuple of int
        Robots of which nothing is asked.
    """

    def __init__(self, plan: Plan, byzantine: tuple[int, ...]) -> None:
        self.known = 0.0
        """Part of the reachable free cells that those who live know at the end."""
        self._plan = plan
        self._liars = byzantine
        self._truth: Grid = np.where(plan.map.cells == FREE, FREE, OCCUPIED).astype(np.uint8)
        self._lives: dict[tuple[int, int], Robot] = {}
        self._checked: dict[int, tuple[Robot, int]] = {}
        """Of each robot the life that it is in, and the step that was checked last."""
        self._own: dict[int, Grid] = {}
        self._held: dict[int, list[int]] = {}

    def inspect(self, step: int, robot: Robot) -> None:
        """Check a robot, once a step, when the step is over.

        Raises
        ------
        Violation
            Something does not hold.
        """
        number = robot.settings.robot
        incarnation, last = self._checked.get(number, (None, -1))
        if number in self._liars or (incarnation is robot and last == step):
            return
        self._lives[number, robot.settings.incarnation] = robot
        self._checked[number] = robot, step
        held = [len(log) for log in robot.replication.logs]
        who = f"step {step}: robot {number}"
        known = robot.own != UNKNOWN
        if (robot.own != self._truth)[known].any():
            raise Violation(f"{who} has seen what is not so")
        if step and (robot.planning != robot.own)[known].any():
            raise Violation(f"{who} plans on cells otherwise than it has seen them")
        if incarnation is robot:
            if (robot.own == UNKNOWN)[self._own[number] != UNKNOWN].any():
                raise Violation(f"{who} does not know any more what it has seen")
            for map_id, (then, now) in enumerate(zip(self._held[number], held, strict=True)):
                if now < then and map_id != robot.settings.own_map:
                    raise Violation(f"{who} held {then} units of map {map_id}, and now {now}")
        self._own[number], self._held[number] = robot.own.copy(), held

    def conclude(self, records: Records) -> None:
        """Check the end of a run; Violation if something does not hold."""
        summary = summarize(self._plan, records, 1.0)
        if not summary["finished"]:
            raise Violation(f"nobody was done: the run ended because of: {summary['reason']}")
        if records.lost:
            raise Violation(f"robots were lost: {records.lost}")
        if summary["over_budget_steps"]:
            raise Violation(f"{summary['over_budget_steps']} steps carried more than the budget")
        self._check_books(records)
        reachable = self._plan.make_world().reachable
        honest = [grid for robot, grid in records.planning.items() if robot not in self._liars]
        if honest:
            known = np.logical_or.reduce([grid == FREE for grid in honest]) & reachable
            self.known = float(known.sum() / reachable.sum())
            if self.known < ENOUGH:
                raise Violation(f"those who live know {self.known:.3f} of the world, not {ENOUGH} of it")
        if not self._liars:
            self._check_logs()

    def _check_books(self, records: Records) -> None:
        rows = records.ledger()
        for step, (said, carried, cut, heard) in balance(rows).items():
            unicast = (rows["step"] == step) & (rows["receiver"] >= 0) & (rows["carried"] == 1)
            to_one = int(rows["bytes"][unicast].sum())
            if said != carried + cut or (heard != to_one and self._plan.radio.perfect):
                raise Violation(
                    f"step {step}: {said} bytes were said, {carried} carried, {cut} cut; "
                    f"of {to_one} to one robot {heard} were heard"
                )

    def _check_logs(self) -> None:
        """What is held of a log is what its maker wrote."""
        robots = self._plan.scenario.robots
        for (number, incarnation), robot in self._lives.items():
            for map_id, log in enumerate(robot.replication.logs):
                maker = self._lives.get((map_id % robots, map_id // robots))
                if maker is None or maker is robot:
                    continue
                written = maker.replication.logs[map_id]
                first = max(log.start, written.start)
                held = log.read(first, None) if first < len(log) else b""
                if held != written.read(first, None)[: len(held)]:
                    raise Violation(
                        f"robot {number} in life {incarnation} holds units of map {map_id} that nobody wrote"
                    )
