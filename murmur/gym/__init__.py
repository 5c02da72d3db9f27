"""Environments in which a policy chooses the goals of exploring robots: Gymnasium and PettingZoo.

``gymnasium.make("murmur.gym:murmur/Explore-v0", map="em", robots=2)`` controls one robot, `TeamEnv` all of them
(docs/learning.md). They need the extra ``murmur-robots[gym]``.
"""

from __future__ import annotations

try:
    import gymnasium
    import pettingzoo  # noqa: F401
except ImportError as error:
    raise ImportError(
        f"murmur.gym needs the package {error.name}: pip install 'murmur-robots[gym]'"
    ) from error

from murmur.gym.episode import Progress
from murmur.gym.explore_env import ExploreEnv
from murmur.gym.rewards import discovery
from murmur.gym.team_env import TeamEnv

__all__ = ["ENVIRONMENT", "ExploreEnv", "Progress", "TeamEnv", "discovery"]

ENVIRONMENT = "murmur/Explore-v0"
"""The name under which Gymnasium makes an `ExploreEnv`."""

if ENVIRONMENT not in gymnasium.registry:
    gymnasium.register(ENVIRONMENT, entry_point="murmur.gym.explore_env:ExploreEnv")
