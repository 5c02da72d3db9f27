"""Costs, paths and frontiers on one planning grid, each computed on first use."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from agent.memo_cache import NO_CACHE, Content, MemoCache, Result
from agent.planning.best_frontier import TradeOff, best_frontier
from agent.planning.breadth_first import first_by_hops
from agent.planning.cost_field import Field, costs, costs_to, nearest_first, way, way_between
from agent.planning.frontier import Floor, Regions
from agent.planning.jump_point_search import GoalCosts
from agent.planning.occupancy import barred, entry_costs, weighted_costs
from protocol.arrays import Cells, FloatRows, Floats
from protocol.grid import OCCUPIED, Cell, Grid, enlarge

COSTS = ("shortest", "weighted")
"""Cost of a way. ``shortest``: its length. ``weighted``: its length times the occupancy of a smoothed map, so that ways
keep away from walls (Burgard et al. 2005, section II-A)."""


class PathPlanner:
    """Path planner of one robot on one planning grid, shape (h, w).

    `kind` is one of `COSTS`. Obstacles are enlarged by the robot's radius; `floor` is the grid with enlarged obstacles,
    computed by default. Cells of more occupancy than `occ_max` on a smoothed map are obstacles
    (`agent.planning.occupancy.barred`). `cache` has intermediate results, shared by the robots of this process.
    """

    def __init__(
        self,
        grid: Grid,
        kind: str = "shortest",
        radius_cells: float = 0.0,
        floor: Grid | None = None,
        occ_max: float = 1.0,
        cache: MemoCache = NO_CACHE,
    ) -> None:
        self.grid = grid
        self.floor = barred(grid, enlarge(grid, radius_cells), occ_max) if floor is None else floor
        self._kind = kind
        self._radius = radius_cells
        self._occ_max = occ_max
        self._cache = cache
        self._others: dict[float, PathPlanner] = {}
        """The planners of robots of other radii."""
        self._fields: dict[Cell, Field] = {}
        """The costs of ways from a cell to every cell."""
        self._ways: dict[tuple[Cell, Cell], Cells] = {}
        self._lengths: dict[tuple[Cell, Cell], float] = {}
        """`_ways`, `_lengths`: best ways that searches found, and costs of best ways (`note_cost`), by both ends."""

    @cached_property
    def _laid_out(self) -> Floor:
        return Floor(self.floor)

    @cached_property
    def _content(self) -> Content:
        """The floor and the grid; robots with equal ones use the same object, which is the fastest to compare."""
        content = Content(self.floor) if self.floor is self.grid else Content(self.floor, self.grid)
        return self._cache.get(content, lambda: content)

    @cached_property
    def _weights(self) -> FloatRows | None:
        return entry_costs(self.grid) if self._kind == "weighted" else None

    def costs(self, x: int, y: int) -> Field:
        """Return the cost of the best way from cell (x, y) to every cell, shape (h, w); infinite without a way."""
        if (x, y) not in self._fields:
            if self._weights is None:
                self._fields[x, y] = costs(self._laid_out, x, y)
            else:
                self._fields[x, y] = weighted_costs(self.floor, self._weights, x, y)
        return self._fields[x, y]

    def costs_to(self, x: int, y: int, cells: Cells) -> Floats:
        """Return the cost of the best way from cell (x, y) to each of `cells`, shape (n,); fast for close cells."""
        if self._weights is None and (x, y) not in self._fields:
            return costs_to(self._laid_out, x, y, cells)
        return self.costs(x, y)[cells[:, 1], cells[:, 0]]

    def costs_between(self, starts: Cells, goals: Cells) -> FloatRows:
        """Return the cost of the best way from each of `starts` to each of `goals`, shape (m, n)."""
        if self._weights is None:
            return self._goal_costs(goals).ways(self._laid_out, starts)
        return np.array([self.costs(x, y)[goals[:, 1], goals[:, 0]] for x, y in starts.tolist()])

    def costs_among(self, starts: Cells, goals: Cells) -> tuple[FloatRows, FloatRows]:
        """Return `costs_between` of starts and goals, and of all pairs of goals; callers must not modify the latter."""
        if self._weights is None:
            return self._goal_costs(goals).among(self._laid_out, starts)
        return self.costs_between(starts, goals), self.costs_between(goals, goals)

    def shared(self, key: Hashable, work: Callable[[], Result]) -> Result:
        """Return `work()`, which depends on the grid, the floor and `key` alone; callers must not modify the result.

        Robots of this process that have the same grid and floor compute it once.
        """
        if self._cache is NO_CACHE:
            return work()
        return self._cache.get((self._content, key), work)

    def _goal_costs(self, goals: Cells) -> GoalCosts:
        """Return the costs of ways to these goals that have been searched on this floor."""
        return self.shared((GoalCosts, goals.tobytes()), lambda: GoalCosts(goals))

    def path(self, start: Cell, end: Cell) -> Cells | None:
        """Return the cells of a best way, without the start; None if there is none."""
        if self._weights is not None:
            field = self.costs(*start)
            found = np.isfinite(field[end[1], end[0]])
            return way(self.floor, field, *end, self._weights) if found else None
        if (start, end) in self._ways:
            return self._ways[start, end]
        known = self._fields.get(start)
        if known is not None and np.isfinite(known[end[1], end[0]]):
            return way(self.floor, known, *end)
        length = self._lengths.get((start, end), math.inf)
        found = way_between(self._laid_out, start, end, length)
        if found is None and math.isfinite(length):  # the strategy has changed the cost
            found = way_between(self._laid_out, start, end)
        return found

    def note_cost(self, start: Cell, end: Cell, cost: float) -> None:
        """Note the cost of the best way between two cells, as this planner returned it; `path` is then faster."""
        self._lengths[start, end] = cost

    def frontier(self, x: int, y: int) -> Cells:
        """Return all frontier cells that are reachable from (x, y), row by row; callers must not modify them."""
        return self.shared(Regions, Regions).frontier(self._laid_out, self.grid, x, y)

    def best_frontier(self, x: int, y: int, trade_off: TradeOff) -> Cell | None:
        """Return the frontier cell of the best trade-off of utility and length of way; None if there is none.

        Only for planners of kind ``shortest``. The same search finds the way to the cell.
        """
        return self._keep(x, y, best_frontier(self._laid_out, self.grid, x, y, trade_off))

    def first_frontier(self, x: int, y: int, taken: Cells, ranges: ArrayLike) -> Cell | None:
        """Return the frontier cell nearest to (x, y) that is out of range of all `taken` cells.

        If there is none, the nearest frontier cell; None without a frontier. The search ends at the found cell.
        """
        return self._keep(x, y, nearest_first(self._laid_out, self.grid, x, y, taken, ranges))

    def first_by_hops(self, x: int, y: int, taken: Cells, ranges: ArrayLike) -> Cell | None:
        """Return the first frontier cell of the breadth-first search in `agent.planning.breadth_first`."""
        return self._keep(x, y, first_by_hops(self.floor, self.grid, (x, y), taken, ranges))

    def _keep(self, x: int, y: int, found: tuple[Cell, Cells] | None) -> Cell | None:
        """Keep the way to a found cell for `path`; return the cell."""
        if found is None:
            return None
        cell, self._ways[(x, y), found[0]] = found
        return cell

    def of_radius(self, radius_cells: float) -> PathPlanner:
        """Return the planner of a robot with another radius on the same grid."""
        if radius_cells == self._radius:
            return self
        if radius_cells not in self._others:
            self._others[radius_cells] = PathPlanner(
                self.grid, self._kind, radius_cells, occ_max=self._occ_max, cache=self._cache
            )
        return self._others[radius_cells]

    def without(self, cells: Sequence[Cell]) -> PathPlanner:
        """Return a planner with these cells as additional obstacles; this planner if there are none."""
        if not cells:
            return self
        grid, floor = self.grid.copy(), self.floor.copy()
        for x, y in cells:
            grid[y, x] = floor[y, x] = OCCUPIED
        return PathPlanner(grid, self._kind, self._radius, floor, self._occ_max)
