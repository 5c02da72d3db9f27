"""The Gymnasium environment: a policy chooses the goals of one robot, teammates follow a strategy."""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from deploy.scenario.scenario import Scenario
from murmur.gym.goal_env import GoalEnv
from murmur.gym.observation import Observation, goal, observation_space
from murmur.gym.picture import RENDER_MODES
from murmur.gym.rewards import Reward, discovery, info


class ExploreEnv(GoalEnv, gym.Env[Observation, np.int64]):
    """One robot's policy: it chooses a goal whenever the robot needs one, and the robot plans its way there.

    Observations have what the robot knows: ``map``, ``position``, ``candidates``, ``team``, and ``action_mask``
    (`murmur.gym.observation.observation_space`).

    Actions are numbers: 0 keeps the target, k drives to candidate k. A robot that needs a goal and gets none stays for
    a step. So does one whose action names no candidate; ``action_mask`` tells which actions have an effect.

    An episode is terminated when the run ends (all is explored, no robot makes progress, or all robots are lost), and
    truncated when the scenario has no steps left. It also ends, terminated, when the robot is lost. The same settings,
    seed and actions give the same episode.

    Parameters
    ----------
    scenario : Scenario, optional
        The scenario; its strategy is that of the teammates. Default settings if omitted.
    robot : int
        The robot under control.
    candidates : int
        Largest number of candidates.
    every : int
        Choose after that many steps at the latest; with 0, only when the robot needs a goal.
    reward : callable
        Computes the reward of a step from its `murmur.gym.Progress`; by default `murmur.gym.discovery`.
    render_mode : str, optional
        ``"rgb_array"``, or None.
    **settings
        Settings that replace those of `scenario`: ``ExploreEnv(map="em", robots=2)``.

    Raises
    ------
    ScenarioError
        The scenario is invalid, or has no simulated robots.
    ValueError
        Another argument is invalid.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": list(RENDER_MODES), "render_fps": 10}  # type: ignore[misc]

    def __init__(
        self,
        scenario: Scenario | None = None,
        *,
        robot: int = 0,
        candidates: int = 8,
        every: int = 0,
        reward: Reward = discovery,
        render_mode: str | None = None,
        **settings: Any,
    ) -> None:
        super().__init__(scenario, settings, [robot], candidates, every, reward, render_mode)
        self.robot = robot
        self.observation_space = observation_space(self._plan, candidates)
        self.action_space = gym.spaces.Discrete(candidates + 1)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode.

        `seed` is the seed of the scenario; without one, it is drawn from the environment's own generator. `options` may
        have settings of this episode, ``{"settings": {"map_seed": 3}}``, which keep the size of the map and the team.
        """
        super().reset(seed=seed)
        episode = self._start(seed, self.np_random, options)
        return self._seen_by(self.robot), info(episode, episode.begun)

    def step(self, action: np.int64 | int) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Choose a goal, and run until the next choice; RuntimeError before the first reset."""
        episode = self._started()
        chosen = goal(episode, self.robot, int(action))
        progress = episode.advance({} if chosen is None else {self.robot: chosen})
        truncated = episode.is_truncated
        terminated = not episode.active and not truncated
        observation, reward = self._seen_by(self.robot), float(self.reward(progress))
        return observation, reward, terminated, truncated, info(episode, progress)

    def action_masks(self) -> NDArray[np.bool_]:
        """Return the action mask as booleans, as libraries for maskable policies ask for it."""
        return self._seen_by(self.robot)["action_mask"].astype(np.bool_)
