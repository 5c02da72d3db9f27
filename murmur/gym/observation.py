"""What a policy observes: only what the robot itself knows (`agent.strategies.base.Situation`)."""

from __future__ import annotations

from typing import Any, cast

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from deploy.scenario.plan import Plan
from murmur.gym.episode import Episode
from protocol.grid import Cell

Observation = dict[str, NDArray[Any]]

KEEP = 0
"""The action that keeps the target; action k chooses candidate k - 1."""

NOT_KNOWN = -1
"""Coordinate of positions and targets that the robot does not know."""


def observation_space(plan: Plan, most: int) -> gym.Space[Observation]:
    """Return the space of observations of one robot, with `most` candidates.

    map          uint8 (h, w): the planning grid, row 0 on top; 0 unknown, 1 free, 2 occupied
    position     int32 (2,): the robot's cell (x, y)
    candidates   float32 (most, 4), the nearest first: its cell (x, y), the length of the way in cells, the number of
                 unknown cells within sensor range; unused rows are 0
    team         int32 (robots, 4), by robot: last known cell (x, y), and last known target (x, y); -1 if not known
    action_mask  int8 (most + 1,): 1 for each action that has an effect
    """
    height, width = plan.map.cells.shape
    robots, cells = plan.scenario.robots, height * width
    longest = float(np.hypot(1, 1) * cells)
    cell = np.array([width - 1, height - 1])
    features = np.tile(np.array([*cell, longest, cells], np.float32), (most, 1))
    places = np.tile(np.array([*cell, *cell], np.int32), (robots, 1))
    spaces = gym.spaces.Dict(
        {
            "map": gym.spaces.Box(0, 2, (height, width), np.uint8),
            "position": gym.spaces.Box(np.zeros(2, np.int32), cell.astype(np.int32), dtype=np.int32),
            "candidates": gym.spaces.Box(np.zeros_like(features), features, dtype=np.float32),
            "team": gym.spaces.Box(np.full_like(places, NOT_KNOWN), places, dtype=np.int32),
            "action_mask": gym.spaces.Box(0, 1, (most + 1,), np.int8),
        }
    )
    return cast("gym.Space[Observation]", spaces)


def observe(episode: Episode, robot: int, most: int) -> Observation:
    """Return what a robot knows, as an element of `observation_space`."""
    situation, candidates = episode.situations[robot], episode.candidates(robot)
    count = len(candidates.cells)
    features = np.zeros((most, 4), np.float32)
    features[:count] = np.column_stack([candidates.cells, candidates.ways, candidates.gains])
    team = np.full((episode.plan.scenario.robots, 4), NOT_KNOWN, np.int32)
    for other, pose in situation.poses.items():
        team[other, :2] = pose[:2]
    for other, target in situation.targets.items():
        team[other, 2:] = target
    team[robot, :2] = situation.here
    team[robot, 2:] = episode.target(robot) or NOT_KNOWN
    mask = np.zeros(most + 1, np.int8)
    mask[1 : count + 1] = 1
    mask[KEEP] = not episode.needs_goal(robot)
    return {
        "map": situation.grid.copy(),
        "position": np.array(situation.here, np.int32),
        "candidates": features,
        "team": team,
        "action_mask": mask,
    }


def goal(episode: Episode, robot: int, action: int) -> Cell | None:
    """Return the goal that an action chooses; None if it keeps the target, or if there is no such candidate."""
    cells = episode.candidates(robot).cells
    if not KEEP < action <= len(cells):
        return None
    x, y = cells[action - 1].tolist()
    return x, y
