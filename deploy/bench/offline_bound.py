"""What is possible at all: how soon a team is done that knows the building from the start.

Every strategy's time can so be given as a multiple of what a team needs that only has to look. Two numbers enclose it.
`offline_steps` is a plan that such a team can drive: viewpoints from which together everything is seen, the tours of
all robots through them, then each viewpoint left out or moved for as long as tours get shorter. `fewest_steps`
is a bound that no team can beat: there are cells, its witnesses, in nooks of their own; into predictive of each somebody
has to come, and no way from a place in predictive of one to a place in predictive of another is shorter than the shortest.

Robots are points or discs that drive from cell to cell, see a full turn in every step, and do not hinder each other.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from agent.planning.cost_field import DIAGONAL, Field, Floor, costs_on
from agent.planning.cost_field import way as way_down
from agent.planning.jump_point_search import costs_between
from agent.planning.team_tours import Task, team_tours
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid, enlarge, ray_table
from protocol.scans import draw
from worldsim.cell_motion import drive
from worldsim.laser import cast
from worldsim.world import reachable_from

Cell = tuple[int, int]
Indices = NDArray[np.int64]

LATTICE = 1 / 8
"""Viewpoints are sought on a lattice of this many sensor ranges."""

ROUNDS = 12
"""Rounds of replanning tours and moving viewpoints at most."""

TRIES = 8
"""Places at most that are tried for a viewpoint which is moved."""

APART = 1 / 3
"""Witnesses of the bound are so many sensor ranges apart: from where one is seen to where the other is."""

ASCENTS = 100
"""Steps by which the bound is raised."""


class OfflineBound:
    """A building that is known: what is seen from where, and how far it is from one cell to another.

    Parameters
    ----------
    truth : uint8 array, shape (h, w)
        The true map.
    start : (x, y)
        A cell of the part that robots can reach.
    range_cells : float
        Sensor range.
    speed : float
        Cells that a robot drives in a step.
    beams : int
        Beams a full turn.
    radius_cells : float
        Of each robot.
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
        stands = reachable_from(enlarge(truth, radius_cells), start)
        self._asked = _with_neighbours(stands)
        self.floor: Grid = np.where(stands, FREE, OCCUPIED).astype(np.uint8)
        self.range_cells = range_cells
        self.speed = speed
        self._truth = truth
        self._nobody = np.zeros(truth.shape, np.bool_)
        self._ray_table = ray_table(range_cells, beams)
        self._paper: Grid = np.full_like(truth, UNKNOWN)
        self._laid_out = Floor(self.floor)
        self._ways = _neighbours(self.floor)
        self._seen: dict[Cell, Indices] = {}
        self.field = lru_cache(maxsize=512)(self._field)
        self.looks = lru_cache(maxsize=1 << 14)(self._looks)
        self.viewpoints = self._lattice()
        """Cells from which together everything is seen that can be seen."""
        self.visible = np.zeros(truth.size, np.bool_)
        """What has to be seen, the map laid flat."""
        for cell in self.viewpoints:
            self.visible[self.seen(cell)] = True

    def seen(self, cell: Cell) -> Indices:
        """What has to be seen and is seen from a cell, as places in the map laid flat, ascending.

        A team is done when no cell where a robot may stand has an unknown neighbour: walls have to be seen as well.
        """
        known = self._seen.get(cell)
        if known is None:
            known = self._seen[cell] = self._look(cell)
        return known

    def _look(self, cell: Cell) -> Indices:
        x, y = cell
        change = draw(
            self._paper, self._ray_table, x, y, cast(self._truth, self._nobody, self._ray_table, x, y)
        )
        x0, y0, x1, y1 = change.box
        inside = np.s_[y0:y1, x0:x1]
        box = self._paper[inside]
        ys, xs = np.nonzero((box != UNKNOWN) & self._asked[inside])
        box[:] = UNKNOWN
        seen: Indices = (ys + y0) * self._paper.shape[1] + xs + x0
        return seen

    def is_reached_from(self, start: Cell) -> bool:
        """Whether a robot that starts there can drive to all of it."""
        return bool(self.floor[start[1], start[0]] == FREE)

    def ways_between(self, starts: NDArray[np.int32], goals: NDArray[np.int32]) -> NDArray[np.float64]:
        """Length of the shortest way from each start to each goal, both of shape (n, 2), in cells."""
        return costs_between(self._laid_out, starts, goals)

    def steps(self, tours: Sequence[Sequence[Cell]]) -> int:
        """Steps of the longest tour, the first look included."""
        return 1 + max(self.steps_of(tour) for tour in tours)

    def steps_of(self, tour: Sequence[Cell]) -> int:
        """Steps from stop to stop; each ends a step."""
        return sum(len(self.looks(one, other)) for one, other in pairwise(tour))

    def in_predictive_of(self, cell: Cell) -> NDArray[np.int32]:
        """The cells (x, y), of shape (n, 2), from which a cell is seen."""
        x, y = cell
        reach = int(self.range_cells)
        x0, y0 = max(0, x - reach), max(0, y - reach)
        ys, xs = np.nonzero(self.floor[y0 : y + reach + 1, x0 : x + reach + 1] == FREE)
        place = y * self.floor.shape[1] + x
        near = zip((xs + x0).tolist(), (ys + y0).tolist(), strict=True)
        found = [each for each in near if place in self._look(each)]
        return np.array(found, np.int32).reshape(-1, 2)

    def field_around(self, places: NDArray[np.int32]) -> Field:
        """Length of the shortest way from any of some places, of shape (n, 2), to every cell, in cells."""
        width = self.floor.shape[1]
        starts = places[:, 1].astype(np.int64) * width + places[:, 0]
        field = dijkstra(self._ways, directed=False, indices=starts, min_only=True)
        return np.reshape(field, self.floor.shape)

    def _field(self, cell: Cell) -> Field:
        """Length of the shortest way from a cell to every other, in cells."""
        return costs_on(self._laid_out, *cell)

    def way(self, start: Cell, end: Cell) -> list[Cell]:
        """The cells of a shortest way, without its start."""
        return [(x, y) for x, y in way_down(self.floor, self.field(start), *end).tolist()]

    def _looks(self, start: Cell, end: Cell) -> list[Cell]:
        """Where a robot stands at the end of each step on its way from one cell to another."""
        left = self.way(start, end)
        here, carry, stops = start, 0.0, []
        while left:
            driven = drive(self.floor, self._nobody, here, left, self.speed + carry)
            here, carry = (driven.cells or [here])[-1], driven.carry
            left = left[len(driven.cells) :]
            stops.append(here)
        return stops

    def _lattice(self) -> list[Cell]:
        pitch = max(1, round(LATTICE * self.range_cells))
        stands = self.floor == FREE
        lattice = np.zeros_like(stands)
        lattice[::pitch, ::pitch] = True
        cells = [(int(x), int(y)) for y, x in zip(*np.nonzero(stands & lattice), strict=True)]
        seen = np.zeros(stands.size, np.bool_)
        for cell in cells:
            seen[self.seen(cell)] = True
        width = stands.shape[1]
        for y, x in zip(*np.nonzero(self._asked), strict=True):
            if not seen[y * width + x]:
                cells.append(self._next_to(int(x), int(y)))
                seen[self.seen(cells[-1])] = True
        return cells

    def _next_to(self, x: int, y: int) -> Cell:
        """The cell itself, or else a neighbour of it, where a robot may stand."""
        height, width = self.floor.shape
        near = ((x, y), (x + 1, y), (x, y + 1), (x - 1, y), (x, y - 1))
        inside = (each for each in near if 0 <= each[0] < width and 0 <= each[1] < height)
        return next(each for each in inside if self.floor[each[1], each[0]] == FREE)


def _with_neighbours(cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Cells and their 4-neighbours, as masks of shape (h, w)."""
    found = cells.copy()
    found[1:] |= cells[:-1]
    found[:-1] |= cells[1:]
    found[:, 1:] |= cells[:, :-1]
    found[:, :-1] |= cells[:, 1:]
    return found


def _neighbours(floor: Grid) -> csr_matrix:
    """Ways from each free cell to its neighbours, half of them; corners are not cut."""
    free = floor == FREE
    number = np.arange(floor.size).reshape(floor.shape)
    height, width = floor.shape
    ends, lengths = [], []
    for dx, dy in ((1, 0), (0, 1), (1, 1), (-1, 1)):
        here = np.s_[0 : height - dy, max(0, -dx) : width - max(0, dx)]
        there = np.s_[dy:height, max(0, dx) : width + min(0, dx)]
        beside = np.s_[0 : height - dy, max(0, dx) : width + min(0, dx)]
        below = np.s_[dy:height, max(0, -dx) : width - max(0, dx)]
        open_ = free[here] & free[there] & free[beside] & free[below]
        ends.append((number[here][open_], number[there][open_]))
        lengths.append(np.full(len(ends[-1][0]), DIAGONAL if dx and dy else 1.0))
    one, other = (np.concatenate([pair[side] for pair in ends]) for side in (0, 1))
    return csr_matrix((np.concatenate(lengths), (one, other)), shape=(floor.size, floor.size))


def offline_steps(building: OfflineBound, starts: Sequence[Cell]) -> int:
    """Steps in which a team can see everything, by a plan made with the map known."""
    return building.steps(offline_tours(building, starts))


def offline_tours(building: OfflineBound, starts: Sequence[Cell]) -> list[list[Cell]]:
    """Plan how a team sees everything soon.

    Parameters
    ----------
    building : KnownMap
    starts : sequence of (x, y)
        Where each robot starts.

    Returns
    -------
    list of lists of (x, y)
        For each robot its start, then where it stops to look; it looks at the end of each step on the way as well.
    """
    plan = _Plan(building, starts)
    plan.order([])
    for _ in range(ROUNDS):
        before = building.steps(plan.tours)
        plan.improve()
        now, driven = building.steps(plan.tours), plan.tours
        plan.order([cell for tour in driven for cell in tour[1:]])
        if building.steps(plan.tours) > now:
            plan.tours = driven
        if building.steps(plan.tours) >= before:
            break
    return plan.tours


def _cover(building: OfflineBound, left: NDArray[np.bool_]) -> list[Cell]:
    """Choose viewpoints until all that is left is seen, each time the one that sees most of it.

    `left` has a flag a cell, laid flat; it comes back empty of what can be seen at all.
    """
    # What a viewpoint adds never grows: the one on top is the best if it still adds what it last did.
    queue = [
        (-np.count_nonzero(left[building.seen(cell)]), at) for at, cell in enumerate(building.viewpoints)
    ]
    heapq.heapify(queue)
    chosen = []
    while queue and queue[0][0]:
        adds, at = queue[0]
        cell = building.viewpoints[at]
        now = -np.count_nonzero(left[building.seen(cell)])
        if now > adds:
            heapq.heapreplace(queue, (now, at))
            continue
        heapq.heappop(queue)
        chosen.append(cell)
        left[building.seen(cell)] = False
    return chosen


class _Plan:
    """Each robot's tour: its start, then the viewpoints in the order in which it stops there to look."""

    def __init__(self, building: OfflineBound, starts: Sequence[Cell]) -> None:
        self.tours: list[list[Cell]] = [[start] for start in starts]
        self._building = building
        self._starts = list(starts)

    def order(self, viewpoints: Sequence[Cell]) -> None:
        """Share viewpoints among the robots so that the longest tour is short; add some for what is not seen."""
        stops = list(viewpoints)
        while True:
            self.tours = self._shared(stops)
            left = self._building.visible.copy()
            for tour in self.tours:
                for cell in (tour[0], *self._looks(tour)):
                    left[self._building.seen(cell)] = False
            if not left.any():
                return
            stops = [cell for tour in self.tours for cell in tour[1:]] + _cover(self._building, left)

    def _shared(self, stops: list[Cell]) -> list[list[Cell]]:
        count, robots = len(stops), len(self._starts)
        cells = np.array([*self._starts, *stops], np.int32)
        ways = self._building.ways_between(cells, cells[robots:])
        few = np.full(count, 0.1 / max(1, count))
        none = np.zeros(count)
        task = Task(
            ways[:robots].copy(),
            ways[robots:].copy(),
            few,
            latency_weight=none,
            last=1.0,
            way=0.0,
            loads=none,
        )
        tours = team_tours(task)
        return [[start, *(stops[at] for at in tour)] for start, tour in zip(self._starts, tours, strict=True)]

    def improve(self) -> None:
        """Leave out viewpoints that nobody misses; move others to where they lengthen their tour least."""
        counts = np.zeros(self._building.floor.size, np.int64)
        for tour in self.tours:
            counts[self._building.seen(tour[0])] += 1
            self._count(counts, tour, 1)
        for tour in sorted(self.tours, key=self._building.steps_of, reverse=True):
            at = 1
            while at < len(tour):
                at += self._stays(tour, at, counts)

    def _stays(self, tour: list[Cell], at: int, counts: Indices) -> bool:
        """Take one viewpoint out of a tour, and put the best in its place, if any is needed; whether one is."""
        ends = tour[at - 1], tour[at], *tour[at + 1 : at + 2]
        self._count(counts, ends, -1)
        lost = np.unique(np.concatenate([self._building.seen(cell) for cell in self._looks(ends)]))
        lost = lost[counts[lost] == 0]
        missed = self._unseen(lost, (ends[0], *ends[2:]))
        if len(missed):
            tour[at] = self._nearest(ends, lost, missed)
        else:
            del tour[at]
        self._count(counts, tour[at - 1 : at + 1 + (len(missed) > 0)], 1)
        return len(missed) > 0

    def _nearest(self, ends: Sequence[Cell], lost: Indices, missed: Indices) -> Cell:
        """The viewpoint between two others that is the smallest detour and loses nothing.

        `lost` is what has to be seen on the way, `missed` what is not seen on the straight way between those two.
        """
        width = self._building.floor.shape[1]
        detours: Field = np.sum([self._building.field(cell) for cell in (ends[0], *ends[2:])], axis=0)
        least = detours[ends[1][1], ends[1][0]]
        y, x = divmod(int(missed[0]), width)
        reach = int(self._building.range_cells)
        x0, y0 = max(0, x - reach), max(0, y - reach)
        there = detours[y0 : y + reach + 1, x0 : x + reach + 1]
        tried = 0
        for place in np.argsort(there, axis=None, kind="stable"):
            dy, dx = divmod(int(place), there.shape[1])
            cell = x0 + dx, y0 + dy
            if not there[dy, dx] < least - 1e-9 or tried == TRIES:
                break
            if not len(np.setdiff1d(missed, self._building.seen(cell), assume_unique=True)):
                tried += 1
                if not len(self._unseen(lost, (ends[0], cell, *ends[2:]))):
                    return cell
        return ends[1]

    def _looks(self, stops: Sequence[Cell]) -> list[Cell]:
        """Where a robot looks on its way from the first of some stops to the last."""
        return [cell for one, other in pairwise(stops) for cell in self._building.looks(one, other)]

    def _unseen(self, cells: Indices, stops: Sequence[Cell]) -> Indices:
        """Those of some cells that are not seen on the way from stop to stop."""
        for cell in self._looks(stops)[::-1]:
            if not len(cells):
                break
            cells = np.setdiff1d(cells, self._building.seen(cell), assume_unique=True)
        return cells

    def _count(self, counts: Indices, stops: Sequence[Cell], by: int) -> None:
        """Count what is seen on the way from stop to stop."""
        for cell in self._looks(stops):
            counts[self._building.seen(cell)] += by


def fewest_steps(building: OfflineBound, starts: Sequence[Cell]) -> int:
    """Steps that a team needs at least until it has seen everything.

    Parameters
    ----------
    building : KnownMap
    starts : sequence of (x, y)
        Where each robot starts.

    Notes
    -----
    All tours together join the starts with a place in predictive of each witness, and the longest is not shorter than
    their mean. Joined at least cost they are a spanning tree over the witnesses and one node for all starts; no
    tour leaves a witness more than once, so a price on each way at a witness, paid back twice, raises the tree
    and never the tours: the bound of Held and Karp.
    """
    fields = [np.min([building.field(start) for start in starts], axis=0)]
    ways = np.zeros((1, 1))
    at_once = np.zeros(building.floor.shape, np.bool_)
    at_once.ravel()[np.concatenate([building.seen(start) for start in starts])] = True
    apart = APART * building.range_cells
    for x, y in sorted(building.viewpoints, key=lambda cell: len(building.seen(cell))):
        if at_once[y, x] or min(field[y, x] for field in fields) < apart:
            continue
        likely = building.seen((x, y))
        if min(float(field.ravel()[likely].min()) for field in fields) < apart:
            continue
        places = building.in_predictive_of((x, y))
        to_others = [float(field[places[:, 1], places[:, 0]].min()) for field in fields]
        if min(to_others) < apart:
            continue
        ways = np.pad(ways, (0, 1))
        ways[-1, :-1] = ways[:-1, -1] = to_others
        fields.append(building.field_around(places))
    least = max(float(ways[0].max()), _least_tours(ways) / len(starts))
    return 1 + math.ceil(least / building.speed - 1e-9)


def _least_tours(ways: NDArray[np.float64]) -> float:
    """Length that tours from node 0 through all others have at least, all together."""
    prices = np.zeros(len(ways))
    best, pace = 0.0, float(ways.max()) / 4
    for ascent in range(ASCENTS):
        length, degrees = _spanning_tree(ways + prices[:, None] + prices)
        best = max(best, length - 2 * float(prices.sum()))
        prices = np.maximum(prices + pace / (1 + ascent) * (degrees - 2), 0.0)
        prices[0] = 0.0
    return best


def _spanning_tree(ways: NDArray[np.float64]) -> tuple[float, Indices]:
    """Length of the shortest spanning tree (Prim), and how many of its ways each node has."""
    degrees = np.zeros(len(ways), np.int64)
    to_tree, joint = ways[0].copy(), np.zeros(len(ways), np.int64)
    to_tree[0] = np.inf
    length = 0.0
    outside = np.ones(len(ways), np.bool_)
    outside[0] = False
    for _ in range(len(ways) - 1):
        node = int(np.argmin(np.where(outside, to_tree, np.inf)))
        length += float(to_tree[node])
        degrees[[node, joint[node]]] += 1
        outside[node] = False
        nearer = ways[node] < to_tree
        to_tree[nearer], joint[nearer] = ways[node][nearer], node
    return length, degrees
