"""Strategies that decide on small maps, for tests."""

from __future__ import annotations

from typing import Any

from agent.strategies.base import Decision, Situation, Strategy
from agent.strategies.registry import strategy
from protocol.grid import UNKNOWN, Grid
from tests.agent.planning.planning_references import drawn, settings_for

# Two frontier cells, (0, 1) and (14, 1), at the ends of a corridor.
CORRIDOR = drawn("###############", "..............." , "###############")  # fmt: skip
CORRIDOR[0, 0] = CORRIDOR[0, 14] = UNKNOWN


SHORTEST = {"costs": "shortest"}


def robot_at(x: int, y: int = 1, grid: Grid = CORRIDOR, **others: Any) -> Situation:
    return Situation(step=1, grid=grid, x=x, y=y, home=(x, y), **others)


def make_strategy(
    name: str, options: dict[str, Any] | None = None, grid: Grid = CORRIDOR, **settings: Any
) -> Strategy:
    return strategy(name)(options or {}, settings_for(grid, **settings))


def decide(
    name: str, situation: Situation, options: dict[str, Any] | None = None, **settings: Any
) -> Decision:
    return make_strategy(name, options, situation.grid, **settings).decide(situation)
