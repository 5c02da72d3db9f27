"""Exploration with a scanner that turns (Al-khawaldah and Nuechter, section 3), and the bids it replaces.

    stop-scan-replan     a full turn at each target, then the next one (3.1, Algorithm 1)
    scan-replan          at the target, at once the next one (3.2)
    continuous-replan    the next one as soon as anyone has opened the target (3.3)
    classical            scans only at its targets, and takes the best bid (3.4)
    sheng-bid            the quoted baseline (Eq. 1): the best bid, scanning all the time

Each but the last tells what it has seen when it has reached its target, or replaces it. A scenario's
`scanner_turn` is 72 or 18 degrees a step in the paper; with 0 a full turn takes one step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.planning.candidates import CANDIDATES, SEARCHED
from agent.planning.gain import information_gain
from agent.planning.path_planner import PathPlanner
from agent.strategies.base import Cell, Situation
from agent.strategies.meier import BREADTH_FIRST_IS_ONE
from agent.strategies.options import option
from agent.strategies.targets import REPLANNING, SCANNING, SHARING, Parts, TargetStrategy

HERDING = "choose again when a lower-numbered robot is headed for the same place"


@dataclass(frozen=True)
class Turning(Parts):
    """Options of `stop-scan-replan`."""

    candidates: str = option("breadth-first", "which cells are worth going to", CANDIDATES)
    replan: str = option("after-turn", "when a new target is chosen", REPLANNING)
    share: str = option("at-target", "when teammates get what was seen", SHARING)
    herding: bool = option(False, HERDING)


@dataclass(frozen=True)
class Moving(Turning):
    """Options of `scan-replan`."""

    replan: str = option("at-goal", "when a new target is chosen", REPLANNING)


@dataclass(frozen=True)
class Continuous(Turning):
    """Options of `continuous-replan`."""

    replan: str = option("at-once", "when a new target is chosen", REPLANNING)


class Rotating(TargetStrategy):
    """What all of them do."""

    def is_due(self, situation: Situation) -> bool:
        """As the parts say; and, if asked to, as if robots chose one after another."""
        return super().is_due(situation) or (self.options.herding and self.herds(situation))


class StopScanReplan(Rotating):
    """Stop, scan, replan, go."""

    name = "stop-scan-replan"
    summary = "a full turn of the scanner at each target, then to the nearest frontier nobody is headed for"
    source = "Al-khawaldah and Nuechter 2014, section 3.1, Algorithm 1"
    options_type = Turning

    @classmethod
    def clashes(cls, parts: Any) -> list[tuple[tuple[str, ...], str]]:
        """All that clash, and more than one candidate."""
        found = super().clashes(parts)
        if parts.candidates not in SEARCHED:
            reason = "it takes the first cell that its search meets; nearest chooses among several"
            found.append((("candidates",), reason))
        return found

    def choose(self, situation: Situation, goals: NDArray[np.int32], planner: PathPlanner) -> Cell | None:
        """Take the cell that the search has found."""
        del situation, planner
        return int(goals[0, 0]), int(goals[0, 1])


class ScanReplan(StopScanReplan):
    """Scan, replan, go."""

    name = "scan-replan"
    summary = "scans on the way, and goes on from each target at once"
    source = "Al-khawaldah and Nuechter 2014, section 3.2"
    options_type = Moving


class ContinuousReplan(StopScanReplan):
    """Continuously replanning."""

    name = "continuous-replan"
    summary = "scans on the way, and takes a new target as soon as anyone has opened the old one"
    source = "Al-khawaldah and Nuechter 2014, section 3.3"
    options_type = Continuous


@dataclass(frozen=True)
class Bids(Parts):
    """Options of `sheng-bid`."""

    gain: float = option(1.0, "w1: weight of the share of the sensor's disc that is still unknown", least=0)
    distance: float = option(0.3, "w2: weight of the way, in sensor ranges", least=0)
    nearness: float = option(
        0.05, "w3: weight of nearness, minus the distance to the nearest teammate", least=0
    )
    herding: bool = option(False, HERDING)


@dataclass(frozen=True)
class ClassicalBids(Bids):
    """Options of `classical`."""

    replan: str = option("after-turn", "when a new target is chosen", REPLANNING)
    scan: str = option("at-target", "when the scanner works", SCANNING)
    share: str = option("at-target", "when teammates get what was seen", SHARING)


class ShengBid(Rotating):
    """The best bid."""

    name = "sheng-bid"
    summary = "takes the frontier cell of the best bid: unknown area, distance, nearness to teammates"
    source = "Sheng et al. 2006, as Al-khawaldah and Nuechter 2014 quote it, Eq. (1)"
    options_type = Bids
    publishes_pose = True

    @classmethod
    def clashes(cls, parts: Any) -> list[tuple[tuple[str, ...], str]]:
        """All that clash, and a single candidate."""
        found = super().clashes(parts)
        if parts.candidates in SEARCHED:
            found.append((("candidates",), BREADTH_FIRST_IS_ONE))
        return found

    def choose(self, situation: Situation, goals: NDArray[np.int32], planner: PathPlanner) -> Cell | None:
        """Take the largest bid; of equals the first cell, row by row."""
        best = goals[np.argmax(self.bids(situation, goals, planner))]
        return int(best[0]), int(best[1])

    def bids(
        self, situation: Situation, goals: NDArray[np.int32], planner: PathPlanner
    ) -> NDArray[np.float64]:
        """Eq. (1), g = w1 I - w2 D + w3 lambda, for each goal.

        The paper leaves units open. Here I is the share of the disc of sensor range, and D and lambda are in
        sensor ranges, the longest of the team; lambda is minus the straight distance to the nearest teammate whose
        pose is known.
        """
        range_cells, scale = self.settings.range_cells, self.settings.scale_cells
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
        bids: NDArray[np.float64] = (
            weights.gain * share - weights.distance * distance + weights.nearness * nearness
        )
        return bids


class Classical(ShengBid):
    """Stop, scan, plan, go."""

    name = "classical"
    summary = "scans only at its targets, a full turn each, and takes the best bid"
    source = "Al-khawaldah and Nuechter 2014, section 3.4"
    options_type = ClassicalBids
