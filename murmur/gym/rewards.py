"""The default reward, and what `info` says about a step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from murmur.gym.episode import Episode, Progress

STEP_COST = 0.1
"""What a step costs, in percent of the reachable cells."""

Reward = Callable[[Progress], float]
"""Computes a reward from what has happened since the last choice of goals."""


def discovery(progress: Progress) -> float:
    """Return the percentage of the reachable cells that the team has newly seen, minus `STEP_COST` per step."""
    return 100 * progress.new_cells / progress.reachable_cells - STEP_COST * progress.steps


def info(episode: Episode, progress: Progress) -> dict[str, Any]:
    """Return what a caller may log of a step, but a robot does not know."""
    return {
        "step": episode.step,
        "steps": progress.steps,
        "new_cells": progress.new_cells,
        "explored": progress.seen_cells / progress.reachable_cells,
        "sent_bytes": progress.sent_bytes,
        "seed": episode.plan.scenario.seed,
    }
