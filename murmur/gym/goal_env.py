"""The common part of both environments: their episodes, rewards, pictures, and results."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deploy.run.result import Result
from murmur.gym.episode import Episode
from murmur.gym.episodes import Episodes, draw_seed
from murmur.gym.observation import Observation, observe
from murmur.gym.picture import checked_mode, picture
from murmur.gym.rewards import Reward


class GoalEnv:
    """An environment in which a policy chooses goals; `ExploreEnv` describes the parameters."""

    def __init__(self, episodes: Episodes, reward: Reward, render_mode: str | None) -> None:
        self.reward = reward
        self.render_mode = checked_mode(render_mode)
        self._episodes = episodes
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
        """Start an episode with a seed, or with a drawn one."""
        self._episode = self._episodes.start(draw_seed(random) if seed is None else seed, options)
        return self._episode

    def _started(self) -> Episode:
        """Return the episode; RuntimeError before the first reset."""
        if self._episode is None:
            raise RuntimeError("no episode has been started: call reset first")
        return self._episode

    def _seen_by(self, robot: int) -> Observation:
        """Return what a robot observes."""
        return observe(self._started(), robot, self._episodes.most)
