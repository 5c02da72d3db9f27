"""The common part of both environments: the choice of seeds, episodes, rewards, pictures, and results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deploy.run import memory
from deploy.run.exploration import scenario_of
from deploy.run.result import Result
from deploy.scenario import plan as plans
from deploy.scenario.errors import ScenarioError
from deploy.scenario.scenario import Scenario
from murmur.gym.episode import Episode
from murmur.gym.observation import Observation, observe
from murmur.gym.picture import RENDER_MODES, picture
from murmur.gym.rewards import Reward

MAX_SEED = 2**31
"""Drawn seeds are smaller."""

MAP_SETTINGS = ("map", "map_seed", "map_options")


class GoalEnv:
    """An environment in which a policy chooses the goals of `robots`, by default of all; then no strategy is used.

    `ExploreEnv` describes the other parameters, and the errors.
    """

    def __init__(
        self,
        scenario: Scenario | None,
        settings: Mapping[str, Any],
        robots: Sequence[int] | None,
        candidates: int,
        every: int,
        reward: Reward,
        render_mode: str | None,
    ) -> None:
        if candidates < 1:
            raise ValueError(f"candidates = {candidates}: must be at least 1")
        if every < 0:
            raise ValueError(f"every = {every}: must be at least 0; 0 means: only if a robot needs a goal")
        if "seed" in settings:
            raise ValueError(f"seed = {settings['seed']!r}: each episode has its own; give it to reset")
        if render_mode not in (None, *RENDER_MODES):
            named = " or ".join(map(repr, RENDER_MODES))
            raise ValueError(f"render_mode = {render_mode!r}: must be {named}, or None")
        self._scenario = scenario_of(scenario, {**settings, "bus": "memory"})
        if self._scenario.is_recorded or self._scenario.is_field or self._scenario.clock == "wall":
            raise ScenarioError(
                "an environment needs simulated robots, with clock = 'barrier' and no recording"
            )
        self._robots = tuple(range(self._scenario.robots)) if robots is None else tuple(robots)
        for robot in self._robots:
            if not 0 <= robot < self._scenario.robots:
                raise ValueError(f"robot = {robot}: the team has {self._scenario.robots} robots, from 0")
        self.reward = reward
        self.render_mode = render_mode
        self._most, self._every = candidates, every
        self._plan = plans.make(self._scenario)
        """The plan of the first episode; others differ in their seeds."""
        memory.check(self._plan)
        self._episode: Episode | None = None

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture of shape (h, w, 3); None without a render mode."""
        return picture(self._started()) if self.render_mode == "rgb_array" else None

    @property
    def result(self) -> Result:
        """The result of the episode, as `murmur.explore` returns it; RuntimeError before its end."""
        return self._started().result

    def _start(
        self, seed: int | None, random: np.random.Generator, options: Mapping[str, Any] | None
    ) -> Episode:
        """Start an episode with a seed, or with a drawn one.

        `options` may have the key ``"settings"``: a mapping of settings that replace those of the environment in this
        episode. Other keys are ignored.

        Raises ScenarioError if a setting is invalid, or changes the size of the map or the number of robots.
        """
        seed = int(random.integers(MAX_SEED)) if seed is None else seed
        changed = dict((options or {}).get("settings", {}))
        scenario = scenario_of(self._scenario, {**changed, "seed": seed, "bus": "memory"})
        keeps_map = all(getattr(scenario, name) == getattr(self._scenario, name) for name in MAP_SETTINGS)
        plan = plans.make(scenario, self._plan.map if keeps_map else None)
        size, former = ((*each.map.cells.shape, each.scenario.robots) for each in (plan, self._plan))
        if size != former:
            raise ScenarioError(
                "options: height and width of the map in cells, and the number of robots, must be those of the "
                f"environment, {former}, not {size}"
            )
        self._episode = Episode(plan, self._robots, self._most, self._every)
        return self._episode

    def _started(self) -> Episode:
        """Return the episode; RuntimeError before the first reset."""
        if self._episode is None:
            raise RuntimeError("no episode has been started: call reset first")
        return self._episode

    def _seen_by(self, robot: int) -> Observation:
        """Return what a robot observes."""
        return observe(self._started(), robot, self._most)
