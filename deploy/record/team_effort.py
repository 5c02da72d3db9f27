"""Metrics by which other benchmarks measure a team: how far its robots drive, and how much of their work overlaps.

`t95` and `longest_path_95` are those of Ma et al. (DARS 2024), `overlap_sum` and `seen_std` the cooperation metrics of
Explore-Bench (ICRA 2022); see docs/peers.md.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from protocol.grid import FREE, Grid
from protocol.messages import WorldReport


def report_at(world: Sequence[WorldReport], share: float) -> WorldReport | None:
    """Return the first report in which the team has seen this share of the reachable cells; None if it never has."""
    return next((report for report in world if report.seen >= share * report.reachable), None)


def longest_path_m(report: WorldReport | None) -> float | None:
    """Return the distance of the robot that has driven farthest, in meters; None without a report."""
    return max(report.driven) / 1000 if report is not None else None


def seen_by_each(own: Collection[Grid], reachable: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Count, for each cell, the robots that have seen it as free, from their self-explored grids.

    Cells that are not reachable have 0. Shape and axes are those of `reachable`.
    """
    seen = np.zeros(reachable.shape, np.int64)
    for grid in own:
        seen += (grid == FREE) & reachable
    return seen


def overlap(seen: NDArray[np.int64]) -> float:
    """Return the share of the seen cells that several robots have seen; `seen` as of `seen_by_each`."""
    return float((seen > 1).sum() / (seen > 0).sum())


def overlap_sum(seen: NDArray[np.int64]) -> float:
    """Return the cells that each robot has seen, summed over robots, over those that the team has seen, minus 1."""
    return float(seen.sum() / (seen > 0).sum() - 1.0)


def seen_std(own: Collection[Grid], reachable: NDArray[np.bool_]) -> float:
    """Return the standard deviation, over robots, of the share of the reachable cells that each has seen itself."""
    shares = [((grid == FREE) & reachable).sum() / reachable.sum() for grid in own]
    return float(np.std(shares))
