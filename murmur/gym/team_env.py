"""The PettingZoo environment: each robot is an agent that chooses its goals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from pettingzoo import ParallelEnv

from deploy.scenario.scenario import Scenario
from murmur.gym.chosen_goals import ChosenGoals
from murmur.gym.goal_env import GoalEnv
from murmur.gym.observation import Observation, goal, observation_space
from murmur.gym.picture import RENDER_MODES
from murmur.gym.rewards import Reward, discovery, info
from protocol import keys as names

Infos = dict[str, dict[str, Any]]


class TeamEnv(GoalEnv, ParallelEnv[str, Observation, np.int64]):  # type: ignore[misc]
    """A team's policies: all robots choose whenever one of them needs a goal.

    Agents are ``"r0"``, ``"r1"``, ... Actions and observations of each are those of `ExploreEnv`. Robots that still
    drive to a target may keep it (action 0), or take another. An agent without an action keeps its target. All agents
    get the same reward.

    An agent that is lost is terminated. One whose robot is stopped for some steps, or restarts later, remains, but its
    actions have no effect meanwhile. The others are terminated when the run ends, and truncated when the scenario has
    no steps left.

    Parameters
    ----------
    scenario : Scenario, optional
        The scenario, of which the strategy is not used; default settings if omitted.
    candidates, every, reward, render_mode, **settings
        As in `ExploreEnv`, with the same errors; `candidates` and `every` are those of each robot.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "render_modes": list(RENDER_MODES),
        "render_fps": 10,
        "name": "murmur_explore_v0",
    }

    def __init__(
        self,
        scenario: Scenario | None = None,
        *,
        candidates: int = 8,
        every: int = 0,
        reward: Reward = discovery,
        render_mode: str | None = None,
        **settings: Any,
    ) -> None:
        controlled = {"strategy": ChosenGoals, "options": {}}
        super().__init__(scenario, {**settings, **controlled}, None, candidates, every, reward, render_mode)
        self.possible_agents = [names.robot(number) for number in self._robots]
        self.agents: list[str] = []
        self.observation_spaces = {
            agent: observation_space(self._plan, candidates) for agent in self.possible_agents
        }
        self.action_spaces = {agent: gym.spaces.Discrete(candidates + 1) for agent in self.possible_agents}
        self._random = np.random.default_rng()

    def observation_space(self, agent: str) -> gym.Space[Observation]:
        """Return the space of an agent's observations."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> gym.Space[np.int64]:
        """Return the space of an agent's actions."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], Infos]:
        """Start an episode; `seed` and `options` as in `ExploreEnv.reset`."""
        if seed is not None:
            self._random = np.random.default_rng(seed)
        episode = self._start(seed, self._random, options)
        self.agents = [names.robot(number) for number in episode.active]
        return self._observe(self.agents), {agent: info(episode, episode.begun) for agent in self.agents}

    def step(
        self, actions: Mapping[str, np.int64 | int]
    ) -> tuple[dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """Choose goals, and run until a robot needs the next one.

        Raises RuntimeError before the first reset, and ValueError if an action is of no agent.
        """
        episode, acting = self._started(), self.agents
        goals = {}
        for agent, action in actions.items():
            if agent not in self.possible_agents:
                raise ValueError(f"there is no agent {agent!r}; there are {', '.join(self.possible_agents)}")
            chosen = goal(episode, names.number(agent), int(action)) if agent in acting else None
            if chosen is not None:
                goals[names.number(agent)] = chosen
        progress = episode.advance(goals)
        reward, truncated = float(self.reward(progress)), episode.is_truncated
        self.agents = [names.robot(number) for number in episode.active]
        gone = [agent for agent in acting if agent not in self.agents]
        return (
            self._observe(acting),
            dict.fromkeys(acting, reward),
            {agent: agent in gone and not truncated for agent in acting},
            {agent: agent in gone and truncated for agent in acting},
            {agent: info(episode, progress) for agent in acting},
        )

    def _observe(self, agents: list[str]) -> dict[str, Observation]:
        return {agent: self._seen_by(names.number(agent)) for agent in agents}
