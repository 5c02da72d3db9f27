"""Decentralized coordination of the thesis (sections 4.4 and 4.5): the best trade-off of utility and cost.

Every robot chooses for itself the frontier cell t with the largest U(t) - beta V(t), where utilities are
lowered around the received targets of teammates, and V is the length of the way in sensor ranges. With ``costs =
"weighted"`` and `occ_max`, V follows Eq. 4.3: the way avoids cells of high occupancy on a smoothed map.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from agent.planning.best_frontier import TradeOff
from agent.planning.path_planner import PathPlanner
from agent.planning.utility import utilities
from agent.settings import Settings
from agent.strategies.base import Decision, Situation, cell_at
from agent.strategies.options import option
from agent.strategies.past_targets import PastTargets
from agent.strategies.targets import SINGLE_CANDIDATE, BarringParts, TargetStrategy
from protocol.arrays import Cells, Floats
from protocol.grid import Cell


@dataclass(frozen=True)
class Options(BarringParts):
    """Options of the strategy."""

    beta: float = option(1.0, "weight of cost against utility", least=0)
    half_life: float = option(
        0.0, "steps after which a received target counts half; 0: it never ages", least=0
    )
    forget: int = option(
        0, "steps over which the weight of a received target decreases to 0; 0: never", least=0
    )
    past_targets: int = option(
        0, "past targets of each teammate that count until the map shows them; 0: none", least=0
    )
    herding: bool = option(True, "choose again when a lower-numbered robot drives to the same place")


class Meier(TargetStrategy):
    """Best trade-off of utility and cost, decided by each robot alone."""

    name = "meier"
    summary = "each robot takes the frontier of best utility minus cost, and broadcasts it"
    source = "Meier 2005, sections 4.4 and 4.5"
    options_type = Options
    clashes = (*TargetStrategy.clashes, SINGLE_CANDIDATE)

    def __init__(self, options: Mapping[str, Any], settings: Settings) -> None:
        super().__init__(options, settings)
        self._past_targets = PastTargets(self.options.past_targets) if self.options.past_targets else None

    def decide(self, situation: Situation) -> Decision:
        """Note which targets teammates have left, and decide as all strategies with targets do."""
        if self._past_targets is not None:
            self._past_targets.note(situation)
        return super().decide(situation)

    def select(self, situation: Situation, planner: PathPlanner) -> tuple[Cell | None, bool]:
        """Return the best goal; if all frontier cells are goals, a bounded search finds it without listing them."""
        if self.options.candidates != "cells" or self.options.costs != "shortest":
            return super().select(situation, planner)
        trade_off = TradeOff(*self._counted(situation), self.settings.scale_cells, self.options.beta)
        best = planner.best_frontier(*situation.here, trade_off)
        return best, best is not None

    def choose(self, situation: Situation, goals: Cells, planner: PathPlanner) -> Cell | None:
        """Return the goal of the best trade-off; of equal goals the first, row by row."""
        targets, weights, ranges = self._counted(situation)
        worth = utilities(situation.grid, goals, targets, ranges, weights)
        cost = planner.costs(*situation.here)[goals[:, 1], goals[:, 0]] / self.settings.scale_cells
        return cell_at(goals, np.argmax(worth - self.options.beta * cost))

    def _counted(self, situation: Situation) -> tuple[Cells, Floats, Floats]:
        """Return the teammates' targets that lower utilities, the weight of each, and the sensor range of its robot.

        They are the current ones, and with the option `past_targets` earlier ones, at full weight.
        """
        robots, cells = list(situation.targets), list(situation.targets.values())
        weights = self._weights(situation)
        if self._past_targets is not None:
            for robot, cell in self._past_targets.of_team():
                robots.append(robot)
                cells.append(cell)
                weights.append(1.0)
        targets = np.array(cells, np.int32).reshape(-1, 2)
        return targets, np.array(weights, np.float64), self.settings.ranges_of(robots)

    def _weights(self, situation: Situation) -> list[float]:
        """Weight of each teammate's target, which decreases with its age (proposed in section 7.2)."""
        half_life, forget = self.options.half_life, self.options.forget
        if not half_life and not forget:
            return [1.0] * len(situation.targets)
        ages = [situation.step - situation.target_steps[peer] for peer in situation.targets]
        halved = [0.5 ** (age / half_life) if half_life else 1.0 for age in ages]
        left = [max(0.0, 1 - age / forget) if forget else 1.0 for age in ages]
        return [float(one * other) for one, other in zip(halved, left, strict=True)]
