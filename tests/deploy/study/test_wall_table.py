"""The initial model of walls is trained on the scans of an exploration."""

from __future__ import annotations

from agent.predictive.mixer import new_model
from agent.predictive.wall_model import CONTEXTS
from deploy.run.recording_bus import record_senses
from deploy.study.tile_table import shortened
from deploy.study.wall_table import make_streams, train_on
from tests.system.team import small_plan


def size(updates: list[tuple[int, bytes]]) -> int:
    """The bytes of updates."""
    return sum(len(message) for _, message in updates)


def test_a_model_learns_from_an_exploration() -> None:
    plan = small_plan("office", robots=2, map_encoding="scans", bandwidth="unlimited", steps=40)
    senses = record_senses(plan)
    model, first = train_on(make_streams(plan), senses, new_model(CONTEXTS, 1))
    assert size(first) > 50
    _, again = train_on(make_streams(plan), senses, shortened(model))
    assert size(again) < size(first)
