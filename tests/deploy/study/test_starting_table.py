"""The initial counts of the predictive encoding are trained on the scans of an exploration."""

from __future__ import annotations

from agent.predictive import contexts
from deploy.run.recording_bus import record_senses
from deploy.study.starting_table import counted
from tests.system.team import small_plan


def test_counts_are_trained_on_an_exploration() -> None:
    plan = small_plan("office", robots=2, map_encoding="scans", bandwidth="unlimited", steps=20)
    senses = record_senses(plan)
    assert [len(steps) for steps in senses] == [20, 20]
    counts = list(counted(plan, senses))
    assert [table.shape for table in counts] == 2 * [(contexts.CONTEXTS, 2)]
    for table in counts:
        assert table[: contexts.OBSERVED].sum() > 50
        assert table[contexts.MORE_SCANS : contexts.FIRST_POSE].any()
