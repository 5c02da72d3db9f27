"""Metrics by which other benchmarks measure a team: how far its robots drive, and how much of their work overlaps.

`t95` and `longest_path_95` are those of Ma et al. (DARS 2024), `overlap_sum` and `seen_std` the cooperation metrics of
Explore-Bench (ICRA 2022); see docs/peers.md.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from protocol.grid import FREE, Grid, Mask
from protocol.messages import WorldReport


def report_at(world: Sequence[WorldReport], share: float) -> WorldReport | None:
    """Return the first report in which the team has seen this share of the reachable cells; None if it never has."""
    return next((report for report in world if report.seen >= share * report.reachable), None)


def longest_path_m(report: WorldReport | None) -> float | None:
    """Return the distance of the robot that has driven farthest, in meters; None without a report."""
    return max(report.driven) / 1000 if report is not None else None


def overlaps(own: Collection[Grid], reachable: Mask) -> dict[str, float]:
    """Return how much of the reachable cells several robots have seen, from their self-explored grids.

    `overlap`: share of the cells seen by the team that several robots have seen. `overlap_sum`: cells that each robot
    has seen, summed over robots, over those that the team has seen, minus 1. `seen_std`: standard deviation, over
    robots, of the share of the reachable cells that each has seen.
    """
    seen = [(grid == FREE) & reachable for grid in own]
    times = np.sum(seen, axis=0)
    by_team = (times > 0).sum()
    return {
        "overlap": float((times > 1).sum() / by_team),
        "overlap_sum": float(times.sum() / by_team - 1.0),
        "seen_std": float(np.std([of_robot.sum() / reachable.sum() for of_robot in seen])),
    }
