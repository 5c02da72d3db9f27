"""Exploration with a turning scanner (Al-khawaldah and Nuechter 2014, section 3), and the auction baselines.

    stop-scan-replan     a full turn at each target, then the next target (3.1, Algorithm 1)
    scan-replan          the next target immediately at the target (3.2)
    continuous-replan    the next target as soon as the target is no frontier any more (3.3)
    classical            scans at targets alone, and takes the best bid (3.4)
    sheng-bid            the quoted baseline (Eq. 1): the best bid, scanning all the time

All but the last send map changes when they reach or replace a target. The `scanner_turn` of a scenario is 72 or 18
degrees per step in the paper; with 0 a full turn takes one step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from agent.planning.gain import information_gain
from agent.planning.path_planner import PathPlanner
from agent.strategies.base import Situation, cell_at
from agent.strategies.options import option, with_defaults
from agent.strategies.targets import SINGLE_CANDIDATE, Clash, Parts, TargetStrategy, is_searched
from protocol.arrays import Cells, Floats
from protocol.grid import Cell


@dataclass(frozen=True)
class HerdingParts(Parts):
    """Options of all five strategies."""

    herding: bool = option(False, "choose again when a lower-numbered robot drives to the same place")


TURNING = with_defaults(HerdingParts, candidates="breadth-first", replan="after-turn", share="at-target")
"""Options of `stop-scan-replan`."""


class StopScanReplan(TargetStrategy):
    """Stop, scan, replan, go."""

    name = "stop-scan-replan"
    summary = "a full scanner turn at each target, then to the nearest frontier without a teammate"
    source = "Al-khawaldah and Nuechter 2014, section 3.1, Algorithm 1"
    options_type = TURNING
    clashes = (
        *TargetStrategy.clashes,
        Clash(
            ("candidates",),
            lambda parts: not is_searched(parts),
            "it takes the first cell that its search finds; nearest chooses among several",
        ),
    )

    def choose(self, situation: Situation, goals: Cells, planner: PathPlanner) -> Cell | None:
        """Return the cell that the search has found."""
        return cell_at(goals, 0)


class ScanReplan(StopScanReplan):
    """Scan, replan, go."""

    name = "scan-replan"
    summary = "scans on the way, and drives on from each target immediately"
    source = "Al-khawaldah and Nuechter 2014, section 3.2"
    options_type = with_defaults(TURNING, replan="at-goal")


class ContinuousReplan(StopScanReplan):
    """Continuous replanning."""

    name = "continuous-replan"
    summary = "scans on the way, and takes a new target once the old one is no frontier"
    source = "Al-khawaldah and Nuechter 2014, section 3.3"
    options_type = with_defaults(TURNING, replan="at-once")


@dataclass(frozen=True)
class BidOptions(HerdingParts):
    """Options of `sheng-bid`."""

    gain: float = option(1.0, "w1: weight of the unknown share of the sensor's disc", least=0)
    distance: float = option(0.3, "w2: weight of the way, in sensor ranges", least=0)
    nearness: float = option(
        0.05, "w3: weight of nearness, minus the distance to the nearest teammate", least=0
    )


class ShengBid(TargetStrategy):
    """Best bid (Sheng et al. 2006)."""

    name = "sheng-bid"
    summary = "takes the frontier cell of the best bid: unknown area, distance, nearness to teammates"
    source = "Sheng et al. 2006, as Al-khawaldah and Nuechter 2014 quote it, Eq. (1)"
    options_type: ClassVar[type] = BidOptions
    clashes = (*TargetStrategy.clashes, SINGLE_CANDIDATE)
    publishes_pose = True

    def choose(self, situation: Situation, goals: Cells, planner: PathPlanner) -> Cell | None:
        """Return the goal of the largest bid; of equal goals the first, row by row."""
        return cell_at(goals, np.argmax(self.bids(situation, goals, planner)))

    def bids(self, situation: Situation, goals: Cells, planner: PathPlanner) -> Floats:
        """Return the bid of each goal, shape (n,): Eq. (1), g = w1 I - w2 D + w3 lambda.

        The paper does not define the units. Here I is the share of the disc of sensor range, and D and lambda are in
        sensor ranges, the longest of the team; lambda is minus the straight distance to the nearest teammate whose
        pose is known.
        """
        range_cells, scale = self.settings.body.range_cells, self.settings.scale_cells
        poses = [pose[:2] for pose in situation.poses.values()]
        others = poses + list(situation.targets.values())
        ranges = self.settings.ranges_of([*situation.poses, *situation.targets])
        gain = information_gain(situation.grid, goals, range_cells, others, ranges)
        share = gain / (math.pi * range_cells**2)
        distance = planner.costs(*situation.here)[goals[:, 1], goals[:, 0]] / scale
        nearness = np.zeros(len(goals))
        if poses:
            apart = np.array([np.hypot(goals[:, 0] - x, goals[:, 1] - y) for x, y in poses])
            nearness = -apart.min(axis=0) / scale
        weights = self.options
        bids: Floats = weights.gain * share - weights.distance * distance + weights.nearness * nearness
        return bids


class Classical(ShengBid):
    """Best bid, with scans at targets alone."""

    name = "classical"
    summary = "scans at its targets alone, a full turn each, and takes the best bid"
    source = "Al-khawaldah and Nuechter 2014, section 3.4"
    options_type = with_defaults(BidOptions, replan="after-turn", scan="at-target", share="at-target")
