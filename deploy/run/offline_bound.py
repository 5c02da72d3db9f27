"""Offline exploration: how soon a team that knows the building could have seen all of it.

The league table gives each strategy's time as a multiple of the offline plan's: a plan that such a team can drive, and
so an upper bound of the optimum. The plan chooses viewpoints that together see all, tours of all robots through them,
and then drops or moves viewpoints as long as the tours become shorter.

Robots are points or discs that drive from cell to cell, scan a full turn in every step, and never block each other.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from agent.planning.cost_field import Field, costs
from agent.planning.cost_field import way as path_down
from agent.planning.frontier import Floor
from agent.planning.jump_point_search import costs_between
from agent.planning.team_tours import Task, team_tours
from deploy.scenario.plan import Plan
from protocol.arrays import Bools
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Cell, Grid, Mask, enlarge, ray_table
from protocol.scans import draw
from worldsim.laser import cast
from worldsim.motion import drive
from worldsim.regions import part_with

Indices = NDArray[np.int32]

LATTICE = 1 / 8
"""Spacing of candidate viewpoints, in sensor ranges."""

ROUNDS = 12
"""Maximum number of rounds that replan tours and move viewpoints."""

TRIES = 8
"""Maximum number of places tried for a viewpoint that is moved."""


class KnownBuilding:
    """A known building: visibility from each cell, and path lengths between cells.

    `truth`, uint8 of shape (h, w), is the true map, and `start` a cell (x, y) of its reachable part. Robots have a
    sensor range of `range_cells`, `beams` per full turn, and a radius of `radius_cells`, and drive `speed` cells per
    step.
    """

    def __init__(
        self,
        truth: Grid,
        start: Cell,
        range_cells: float,
        speed: float,
        beams: int = 360,
        radius_cells: float = 0.0,
    ) -> None:
        standable = part_with(enlarge(truth, radius_cells) == FREE, start)
        self._required: Mask = binary_dilation(standable)
        self.floor: Grid = np.where(standable, FREE, OCCUPIED).astype(np.uint8)
        """Shape (h, w): the cells where a robot may stand are free, all others occupied."""
        self.range_cells = range_cells
        self.speed = speed
        self._truth = truth
        self._no_robots = np.zeros(truth.shape, np.bool_)
        self._ray_table = ray_table(range_cells, beams)
        self._scratch: Grid = np.full_like(truth, UNKNOWN)
        self.padded_floor = Floor(self.floor)
        self.seen = lru_cache(maxsize=1 << 14)(self._seen_from)
        self.field = lru_cache(maxsize=512)(self._field)
        self.scan_positions = lru_cache(maxsize=1 << 14)(self._scan_positions)
        self.viewpoints = self._lattice()
        """Cells (x, y) that together see everything that can be seen."""
        self.visible = np.zeros(truth.size, np.bool_)
        """The cells that must be seen, on the flattened map, shape (h * w,)."""
        for cell in self.viewpoints:
            self.visible[self.seen(cell)] = True

    def _seen_from(self, cell: Cell) -> Indices:
        """Required cells that are seen from a cell: ascending indices into the flattened map.

        A team has finished when no cell where a robot may stand has an unknown neighbor, so walls are required as well.
        """
        x, y = cell
        readings = cast(self._truth, self._no_robots, self._ray_table, x, y)
        change = draw(self._scratch, self._ray_table, x, y, readings)
        x0, y0, x1, y1 = change.box
        inside = np.s_[y0:y1, x0:x1]
        box = self._scratch[inside]
        ys, xs = np.nonzero((box != UNKNOWN) & self._required[inside])
        box[:] = UNKNOWN
        indices: Indices = ((ys + y0) * self._scratch.shape[1] + xs + x0).astype(np.int32)
        return indices

    def reaches(self, cell: Cell) -> bool:
        """Whether a robot may stand on a cell, and so reach the whole floor from there."""
        return bool(self.floor[cell[1], cell[0]] == FREE)

    def steps(self, tours: Sequence[Sequence[Cell]]) -> int:
        """Steps of the longest tour, including the first scan."""
        return 1 + max(self.steps_of(tour) for tour in tours)

    def steps_of(self, tour: Sequence[Cell]) -> int:
        """Steps from stop to stop; a step ends at each stop."""
        return sum(len(self.scan_positions(one, other)) for one, other in pairwise(tour))

    def _field(self, cell: Cell) -> Field:
        """Shortest path length from a cell to every other cell, in cells."""
        return costs(self.padded_floor, *cell)

    def path(self, start: Cell, end: Cell) -> list[Cell]:
        """The cells of a shortest path, without its start."""
        return [(x, y) for x, y in path_down(self.floor, self.field(start), *end).tolist()]

    def _scan_positions(self, start: Cell, end: Cell) -> list[Cell]:
        """Where a robot stands at the end of each step on its path from one cell to another."""
        left = self.path(start, end)
        here, carry, stops = start, 0.0, []
        while left:
            driven = drive(self.floor, self._no_robots, here, left, self.speed + carry)
            here, carry = (driven.cells or [here])[-1], driven.carry
            left = left[len(driven.cells) :]
            stops.append(here)
        return stops

    def _lattice(self) -> list[Cell]:
        pitch = max(1, round(LATTICE * self.range_cells))
        standable = self.floor == FREE
        lattice = np.zeros_like(standable)
        lattice[::pitch, ::pitch] = True
        cells = [(int(x), int(y)) for y, x in zip(*np.nonzero(standable & lattice), strict=True)]
        seen = np.zeros(standable.size, np.bool_)
        for cell in cells:
            seen[self.seen(cell)] = True
        width = standable.shape[1]
        for y, x in zip(*np.nonzero(self._required), strict=True):
            if not seen[y * width + x]:
                cells.append(self._standable_near(int(x), int(y)))
                seen[self.seen(cells[-1])] = True
        return cells

    def _standable_near(self, x: int, y: int) -> Cell:
        """The cell itself, or else a neighbor, where a robot may stand."""
        height, width = self.floor.shape
        near = ((x, y), (x + 1, y), (x, y + 1), (x - 1, y), (x, y - 1))
        inside = (each for each in near if 0 <= each[0] < width and 0 <= each[1] < height)
        return next(each for each in inside if self.floor[each[1], each[0]] == FREE)


def known_map_steps(plan: Plan) -> int:
    """Return the steps of the offline plan for a run's map and starts.

    All robots are assumed to have the hardware of the first one. The last results are kept, because runs of different
    strategies share them.
    """
    body, cells = plan.world.bodies[0], plan.map.cells
    starts = tuple((int(x), int(y)) for x, y in plan.world.starts)
    hardware = float(body.range_cells), float(body.speed), plan.world.beams, float(body.radius_cells)
    return _known_map_steps(cells.tobytes(), cells.shape, starts, hardware)


@lru_cache(maxsize=8)
def _known_map_steps(
    cells: bytes, shape: tuple[int, ...], starts: tuple[Cell, ...], hardware: tuple[float, float, int, float]
) -> int:
    truth = np.frombuffer(cells, np.uint8).reshape(shape).copy()
    return offline_steps(KnownBuilding(truth, starts[0], *hardware), starts)


def offline_steps(building: KnownBuilding, starts: Sequence[Cell]) -> int:
    """Steps in which a team that knows the map can see everything: an upper bound of the optimum."""
    return building.steps(offline_tours(building, starts))


def offline_tours(building: KnownBuilding, starts: Sequence[Cell]) -> list[list[Cell]]:
    """Plan short tours that together see everything, from the start cell (x, y) of each robot.

    Returns for each robot its start, then its viewpoints; it also scans at the end of each step between them.
    """
    plan = _Plan(building, starts)
    plan.order([])
    for _ in range(ROUNDS):
        before = building.steps(plan.tours)
        plan.improve()
        now, tours = building.steps(plan.tours), plan.tours
        plan.order([cell for tour in tours for cell in tour[1:]])
        if building.steps(plan.tours) > now:
            plan.tours = tours
        if building.steps(plan.tours) >= before:
            break
    return plan.tours


def _cover(building: KnownBuilding, unseen: Bools) -> list[Cell]:
    """Choose viewpoints until all unseen cells are seen: a greedy set cover.

    `unseen` has a flag per cell of the flattened map; the function clears the flags of seen cells.
    """
    # The gain of a viewpoint never grows: the top of the queue is the best if its gain is still the same.
    queue = [
        (-np.count_nonzero(unseen[building.seen(cell)]), at) for at, cell in enumerate(building.viewpoints)
    ]
    heapq.heapify(queue)
    chosen = []
    while queue and queue[0][0]:
        gain, at = queue[0]
        cell = building.viewpoints[at]
        now = -np.count_nonzero(unseen[building.seen(cell)])
        if now > gain:
            heapq.heapreplace(queue, (now, at))
            continue
        heapq.heappop(queue)
        chosen.append(cell)
        unseen[building.seen(cell)] = False
    return chosen


class _Plan:
    """The tours of all robots: each its start, then viewpoints in their order."""

    def __init__(self, building: KnownBuilding, starts: Sequence[Cell]) -> None:
        self.tours: list[list[Cell]] = [[start] for start in starts]
        self._building = building
        self._starts = list(starts)

    def order(self, viewpoints: Sequence[Cell]) -> None:
        """Distribute viewpoints so that the longest tour is short; add viewpoints until everything is seen."""
        stops = list(viewpoints)
        while True:
            self.tours = self._distributed(stops)
            unseen = self._building.visible.copy()
            for tour in self.tours:
                for cell in (tour[0], *self._scan_positions(tour)):
                    unseen[self._building.seen(cell)] = False
            if not unseen.any():
                return
            stops = [cell for tour in self.tours for cell in tour[1:]] + _cover(self._building, unseen)

    def _distributed(self, stops: list[Cell]) -> list[list[Cell]]:
        count, robots = len(stops), len(self._starts)
        cells = np.array([*self._starts, *stops], np.int32)
        lengths = costs_between(self._building.padded_floor, cells, cells[robots:])
        task = Task(
            lengths[:robots].copy(),
            lengths[robots:].copy(),
            np.full(count, 0.1 / max(1, count)),
            latency_weights=np.zeros(count),
            longest_weight=1.0,
            length_weight=0.0,
            loads=np.zeros(count),
        )
        tours = team_tours(task)
        return [[start, *(stops[at] for at in tour)] for start, tour in zip(self._starts, tours, strict=True)]

    def improve(self) -> None:
        """Drop viewpoints that see nothing alone; move the others to where they lengthen their tour least."""
        counts = np.zeros(self._building.floor.size, np.int64)
        for tour in self.tours:
            counts[self._building.seen(tour[0])] += 1
            self._count(counts, tour, 1)
        for tour in sorted(self.tours, key=self._building.steps_of, reverse=True):
            at = 1
            while at < len(tour):
                at += self._drop_or_move(tour, at, counts)

    def _drop_or_move(self, tour: list[Cell], at: int, counts: NDArray[np.int64]) -> bool:
        """Drop one viewpoint of a tour if no cell needs it, else move it; return whether it remains."""
        ends = tour[at - 1], tour[at], *tour[at + 1 : at + 2]
        self._count(counts, ends, -1)
        needed = np.unique(np.concatenate([self._building.seen(cell) for cell in self._scan_positions(ends)]))
        needed = needed[counts[needed] == 0]
        missed = self._unseen(needed, (ends[0], *ends[2:]))
        if len(missed):
            tour[at] = self._best_place(ends, needed, missed)
        else:
            del tour[at]
        self._count(counts, tour[at - 1 : at + 1 + (len(missed) > 0)], 1)
        return len(missed) > 0

    def _best_place(self, ends: Sequence[Cell], needed: Indices, missed: Indices) -> Cell:
        """The viewpoint between two others with the smallest detour that still sees all needed cells.

        `missed` are the needed cells that the direct path between those two does not see.
        """
        detours: Field = np.sum([self._building.field(cell) for cell in (ends[0], *ends[2:])], axis=0)
        current = detours[ends[1][1], ends[1][0]]
        x0, y0, near = self._near(missed)
        there = detours[y0 : y0 + near.shape[0], x0 : x0 + near.shape[1]]
        better = np.flatnonzero(near & (there < current - 1e-9))
        is_missed = self._flags(missed)
        tried = 0
        for place in better[np.argsort(there.ravel()[better], kind="stable")]:
            dy, dx = divmod(int(place), there.shape[1])
            cell = x0 + dx, y0 + dy
            if np.count_nonzero(is_missed[self._building.seen(cell)]) == len(missed):
                tried += 1
                if not len(self._unseen(needed, (ends[0], cell, *ends[2:]))):
                    return cell
            if tried == TRIES:
                break
        return ends[1]

    def _near(self, cells: Indices) -> tuple[int, int, Mask]:
        """Return where a robot may stand to see all of these cells: corner x0, y0 of a box, and a flag per cell of it.

        The flags are a necessary condition: the outermost cells, by x, y, x + y, and x - y, are in range.
        """
        height, width = self._building.floor.shape
        ys, xs = np.divmod(cells, width)
        reach = int(self._building.range_cells)
        x0, y0 = max(0, int(xs[0]) - reach), max(0, int(ys[0]) - reach)
        y, x = np.ogrid[y0 : min(height, ys[0] + reach + 1), x0 : min(width, xs[0] + reach + 1)]
        near = np.ones(np.broadcast_shapes(y.shape, x.shape), np.bool_)
        for direction in (xs, ys, xs + ys, xs - ys):
            for at in (np.argmin(direction), np.argmax(direction)):
                near &= (x - xs[at]) ** 2 + (y - ys[at]) ** 2 <= (reach + 2) ** 2
        return x0, y0, near

    def _scan_positions(self, stops: Sequence[Cell]) -> list[Cell]:
        """Where a robot scans on its path from the first stop to the last."""
        return [cell for one, other in pairwise(stops) for cell in self._building.scan_positions(one, other)]

    def _unseen(self, cells: Indices, stops: Sequence[Cell]) -> Indices:
        """The cells that are not seen on the path from stop to stop."""
        is_unseen = self._flags(cells)
        for cell in self._scan_positions(stops)[::-1]:
            if not len(cells):
                break
            is_unseen[self._building.seen(cell)] = False
            cells = cells[is_unseen[cells]]
        return cells

    def _flags(self, cells: Indices) -> Bools:
        """A flag per cell of the flattened map, set for these cells."""
        flags = np.zeros(self._building.floor.size, np.bool_)
        flags[cells] = True
        return flags

    def _count(self, counts: NDArray[np.int64], stops: Sequence[Cell], change: int) -> None:
        """Change the count of each cell by the number of scans between the stops that see it."""
        for cell in self._scan_positions(stops):
            counts[self._building.seen(cell)] += change
