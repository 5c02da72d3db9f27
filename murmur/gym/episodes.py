"""What the episodes of an environment have in common: scenario, robots under control, and the choice of seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from deploy.run import memory
from deploy.run.exploration import scenario_of
from deploy.scenario import plan as plans
from deploy.scenario.errors import ScenarioError
from deploy.scenario.scenario import Scenario
from murmur.gym.episode import Episode

MAX_SEED = 2**31
"""Drawn seeds are smaller."""

MAP_SETTINGS = ("map", "map_seed", "map_options")

OPTIONS_KEY = "settings"
"""The key in the `options` of a reset whose value has settings of the episode."""


class Episodes:
    """Starts the episodes of an environment.

    Parameters
    ----------
    scenario : Scenario or None
        The scenario; default settings if it is None.
    settings : mapping
        Settings that replace those of `scenario`. The bus is always ``memory``.
    robots : sequence of int, optional
        Robots under control; by default all of them, and then the scenario's strategy is not used.
    most : int
        Largest number of candidates.
    every : int
        Steps after which the caller chooses at the latest; 0: only if a robot needs a goal.

    Raises
    ------
    ScenarioError
        The scenario is invalid, or cannot be an environment.
    ValueError
        Another argument is invalid.
    """

    def __init__(
        self,
        scenario: Scenario | None,
        settings: Mapping[str, Any],
        robots: Sequence[int] | None,
        most: int,
        every: int,
    ) -> None:
        if most < 1:
            raise ValueError(f"candidates = {most}: must be at least 1")
        if every < 0:
            raise ValueError(f"every = {every}: must be at least 0; 0 means: only if a robot needs a goal")
        if "seed" in settings:
            raise ValueError(f"seed = {settings['seed']!r}: each episode has its own; give it to reset")
        self.scenario = scenario_of(scenario, {**settings, "bus": "memory"})
        if self.scenario.is_recorded or self.scenario.is_field or self.scenario.clock == "wall":
            raise ScenarioError(
                "an environment needs simulated robots, with clock = 'barrier' and no recording"
            )
        self.robots = tuple(range(self.scenario.robots)) if robots is None else tuple(robots)
        for robot in self.robots:
            if not 0 <= robot < self.scenario.robots:
                raise ValueError(f"robot = {robot}: the team has {self.scenario.robots} robots, from 0")
        self.most = most
        self.every = every
        self.plan = plans.make(self.scenario)
        """The plan of the first episode; others differ in their seeds."""
        memory.check(self.plan)

    def start(self, seed: int, options: Mapping[str, Any] | None) -> Episode:
        """Start an episode.

        `options` may have the key ``"settings"``: a mapping of settings that replace those of the environment in this
        episode. Other keys are ignored.

        Raises ScenarioError if a setting is invalid, or changes the size of the map or the number of robots.
        """
        changed = dict((options or {}).get(OPTIONS_KEY, {}))
        scenario = scenario_of(self.scenario, {**changed, "seed": seed, "bus": "memory"})
        keeps_map = all(getattr(scenario, name) == getattr(self.scenario, name) for name in MAP_SETTINGS)
        plan = plans.make(scenario, self.plan.map if keeps_map else None)
        size, former = ((each.map.height, each.map.width, each.scenario.robots) for each in (plan, self.plan))
        if size != former:
            raise ScenarioError(
                "options: height and width of the map in cells, and the number of robots, must be those of the "
                f"environment, {former}, not {size}"
            )
        return Episode(plan, self.robots, self.most, self.every)


def draw_seed(random: np.random.Generator) -> int:
    """Return the seed of an episode that is reset without one."""
    return int(random.integers(MAX_SEED))
