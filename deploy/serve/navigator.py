"""A plain planner, in the place of nav2: a shortest path on the true map, along which a robot turns and drives.

A robot that others block waits, then plans a way around those that it sees. If there is none, and it blocks a robot
with a lower number, it backs off until that robot can pass, and waits there (`deploy.serve.giving_way`). If the robot
with the lower number cannot pass either, that robot backs off. A robot gives up after some attempts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from deploy.serve.giving_way import Others, pocket
from protocol.arrays import NO_CELLS
from protocol.grid import FINE, FREE, Cell, Grid
from protocol.map_frame import MapFrame
from protocol.range_scans import UNIT
from protocol.transforms import Pose
from worldsim.motion import NOT_BLOCKED, WALL, glide
from worldsim.people import shortest_way
from worldsim.velocity_world import STOP, Velocity

TOLERANCE_M = 0.5
"""Distance from a goal in a wall up to which a cell that the robot can enter counts as the goal."""
POSITION_M, HEADING_RAD = 0.05, 0.05
"""Errors with which a goal counts as reached."""
LOOKAHEAD = 8
"""Cells of the path ahead to which a robot drives straight if it can."""
TURN_SPEED = 2.0
"""Radians per second."""
WAIT_S = 2.0
"""Time without progress after which a robot plans again."""
PROGRESS_M = 0.1
"""Distance that counts as progress."""
MOST_RECOVERIES = 6
"""New plans for one goal, as in nav2."""
INSISTENT = 3
"""New plans without progress after which a robot backs off for those with higher numbers, too."""
YIELD_S = 20.0
"""Longest time for which a robot backs off and waits."""


class Outcome(Enum):
    """How the way to a goal ended."""

    REACHED = "reached"
    UNREACHABLE = "unreachable"
    STUCK = "stuck"
    REPLACED = "replaced by another goal"
    CANCELED = "canceled"


@dataclass
class Retreat:
    """The cell that a robot leaves, for everyone or for lower numbers only; where it waits, and for how long."""

    left: Cell
    everyone: bool
    pocket: Pose
    lasted_s: float = 0.0


class Navigator:
    """Leads one robot to a goal; all poses are true ones.

    The robot's center may enter the free cells of `floor`, uint8 of shape (h, w), which lies in `frame`. `speed` is in
    meters per second; `step_s` are the seconds between calls of `steer`.
    """

    def __init__(self, floor: Grid, frame: MapFrame, speed: float, step_s: float) -> None:
        from scipy import ndimage  # noqa: PLC0415  slow to import

        self.recoveries = 0
        """New plans for this goal because the robot made no progress."""
        self._floor, self._frame, self._speed, self._step_s = floor, frame, speed, step_s
        self._planned_on = floor
        """The floor of the last plan, without the cells that others occupied then."""
        self._parts, _ = ndimage.label(floor == FREE)
        self._no_robot = np.zeros(floor.shape, np.bool_)
        self.path = NO_CELLS
        """The cells ahead, shape (n, 2)."""
        self._anchor = Pose(0.0, 0.0, 0.0)
        """Where the robot last made progress."""
        self._stalled_s = 0.0
        self._in_vain = 0
        """New plans since it last made progress."""
        self._touched_wall = False
        self._retreat: Retreat | None = None
        """Where the robot backs off to; None while it drives to its goal."""

    def plan(self, here: Pose, goal: Pose, *, is_new: bool = True) -> bool:
        """Plan the way to a goal; return whether there is one. A repeated goal keeps what is known of the last."""
        if is_new:
            self.recoveries, self._in_vain, self._touched_wall, self._retreat = 0, 0, False, None
            self._anchor, self._stalled_s = here, 0.0
        elif self._retreat is not None:
            return True
        return self._plan(here, goal, self._floor if is_new else self._planned_on) or self._plan(
            here, goal, self._floor
        )

    def remaining_m(self, here: Pose) -> float:
        """Return the length of the way that is left."""
        if not len(self.path):
            return 0.0
        points = np.vstack([self._place(here), self.path + 0.5])
        return float(np.hypot(*np.diff(points, axis=0).T).sum()) * self._frame.resolution

    def steer(self, here: Pose, goal: Pose, blocked: str, others: Others) -> tuple[Velocity, Outcome | None]:
        """Return the velocity of the next step, and how the way has ended, if it has.

        `blocked` says what stopped the robot in the last step.
        """
        if self._retreat is not None:
            return self._back_off(self._retreat, here, goal, others), None
        if blocked == WALL:
            self._touched_wall = True
            self._plan(here, goal, self._floor)
        if self._makes_progress(here):
            return self._follow(here, goal)
        self.recoveries += 1
        if self.recoveries > MOST_RECOVERIES:
            return STOP, Outcome.STUCK
        self._in_vain += 1
        around: Grid = np.where(others.taken(), np.uint8(0), self._floor)
        if not self._plan(here, goal, around):
            self._retreat = self._plan_retreat(here, around, others)
            if self._retreat is not None:
                return self._follow(here, self._retreat.pocket)[0], None
            self._plan(here, goal, self._floor)
        return self._follow(here, goal)

    def _plan_retreat(self, here: Pose, around: Grid, others: Others) -> Retreat | None:
        """Plan the way to where this robot blocks none that goes first; None if it need not back off, or cannot."""
        start, everyone = self._cell(here), self._in_vain >= INSISTENT
        ways = others.ways(everyone)
        if not any(way.blocks(start) for way in ways):
            return None
        end = pocket(around, start, ways)
        if end is None:
            return None
        self.path, self._planned_on = shortest_way(around, start, end), around
        return Retreat(start, everyone, self._center(end))

    def _back_off(self, retreat: Retreat, here: Pose, goal: Pose, others: Others) -> Velocity:
        """Return the velocity of a robot that backs off; it drives to its goal again once the others have passed."""
        retreat.lasted_s += self._step_s
        is_there = math.dist(here[:2], retreat.pocket[:2]) <= POSITION_M
        has_passed = is_there and not any(way.blocks(retreat.left) for way in others.ways(retreat.everyone))
        if has_passed or retreat.lasted_s > YIELD_S:
            self._retreat, self._anchor, self._stalled_s = None, here, 0.0
            self._plan(here, goal, self._floor)
        return STOP if is_there else self._follow(here, retreat.pocket)[0]

    def _makes_progress(self, here: Pose) -> bool:
        """Return whether the robot has moved lately; if not, the time without progress begins again."""
        if math.dist(here[:2], self._anchor[:2]) >= min(PROGRESS_M, self._speed * WAIT_S / 4):
            self._anchor, self._stalled_s, self._in_vain = here, 0.0, 0
        self._stalled_s += self._step_s
        if self._stalled_s <= WAIT_S:
            return True
        self._stalled_s = 0.0
        return False

    def _plan(self, here: Pose, goal: Pose, floor: Grid) -> bool:
        start = self._cell(here)
        end = self._nearest(start, goal, floor)
        if end is None:
            return False
        self.path, self._planned_on = shortest_way(floor, start, end), floor
        return bool(len(self.path)) or start == end

    def _nearest(self, start: Cell, goal: Pose, floor: Grid) -> Cell | None:
        """Return the cell nearest to a goal that a robot may enter and reach; None if it is too far."""
        column, row = self._place(goal)
        reach = TOLERANCE_M / self._frame.resolution
        left, top = max(0, math.floor(column - reach)), max(0, math.floor(row - reach))
        area = slice(top, max(top, math.ceil(row + reach))), slice(left, max(left, math.ceil(column + reach)))
        same_part = self._parts[area] == self._parts[start[1], start[0]]
        rows, columns = np.nonzero((floor[area] == FREE) & same_part)
        if not len(rows):
            return None
        away = np.hypot(columns + left + 0.5 - column, rows + top + 0.5 - row)
        nearest = int(np.argmin(away))
        if away[nearest] > max(reach, 1.0):
            return None
        return int(columns[nearest]) + left, int(rows[nearest]) + top

    def _follow(self, here: Pose, goal: Pose) -> tuple[Velocity, Outcome | None]:
        """Drive to the farthest cell ahead to which the way is straight; at the end, turn as the goal says."""
        aim = self._aim(here, goal)
        away = math.dist(here[:2], aim[:2])
        if away <= POSITION_M and len(self.path) <= 1:
            turn = math.remainder(goal.yaw - here.yaw, math.tau)
            if abs(turn) <= HEADING_RAD:
                return STOP, Outcome.REACHED
            return Velocity(0.0, self._turn(turn)), None
        turn = math.remainder(math.atan2(aim.y - here.y, aim.x - here.x) - here.yaw, math.tau)
        if abs(turn) > TURN_SPEED * self._step_s or (self._touched_wall and abs(turn) > HEADING_RAD):
            self._touched_wall = self._touched_wall and abs(turn) > HEADING_RAD
            return Velocity(0.0, self._turn(turn)), None
        return Velocity(min(self._speed, away / self._step_s), self._turn(turn)), None

    def _turn(self, angle: float) -> float:
        return max(-TURN_SPEED, min(TURN_SPEED, angle / self._step_s))

    def _aim(self, here: Pose, goal: Pose) -> Pose:
        """Return the point to drive to, and forget the cells of the path that are behind the robot."""
        place = self._place(here)
        if len(self.path):
            near = self.path[: 2 * LOOKAHEAD] + 0.5 - place
            passed = int(np.argmin(np.hypot(near[:, 0], near[:, 1])))
            self.path = self.path[passed:]
        if len(self.path) <= 1:
            last = self._center(tuple(self.path[-1].tolist()) if len(self.path) else self._cell(here))
            is_near = math.dist(goal[:2], last[:2]) <= TOLERANCE_M
            return goal if is_near and self._is_straight(place, self._place(goal)) else last
        ahead = min(LOOKAHEAD, len(self.path) - 1)
        while ahead and not self._is_straight(place, self.path[ahead] + 0.5):
            ahead //= 2
        return self._center(tuple(self.path[ahead].tolist()))

    def _is_straight(self, here: NDArray[np.float64], there: NDArray[np.float64]) -> bool:
        """Return whether a robot can drive straight between two places, in cells."""
        ends = [tuple(round(FINE * (each - 0.5)) for each in place.tolist()) for place in (here, there)]
        (start_x, start_y), (end_x, end_y) = ends
        way = float(np.hypot(*(there - here))) + 1
        motion = glide(self._planned_on, self._no_robot, (start_x, start_y), [(end_x, end_y)], way)
        return motion.blocked == NOT_BLOCKED

    def _place(self, pose: Pose) -> NDArray[np.float64]:
        """Return a position in cells; the center of cell (0, 0) is at (0.5, 0.5)."""
        return np.array(self._frame.place(pose)) / UNIT

    def _cell(self, pose: Pose) -> Cell:
        x, y = self._frame.place(pose)
        return x // UNIT, y // UNIT

    def _center(self, cell: tuple[int, ...]) -> Pose:
        x, y = self._frame.position(cell[0] + 0.5, cell[1] + 0.5)
        return Pose(x, y, 0.0)
