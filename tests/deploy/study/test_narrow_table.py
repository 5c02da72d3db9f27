"""The initial model of narrow media is trained on the poses of an exploration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from agent.predictive.pose_model import LOG_UNIT, RINGS, start_factors
from deploy.run.recording_bus import record_senses
from deploy.study.narrow_table import COUNTED, Example, examine, fitted, rounded
from tests.system.team import small_plan


def test_factors_learn_from_an_exploration() -> None:
    plan = small_plan("office", robots=2, map_encoding="scans", bandwidth="unlimited", steps=40)
    senses = record_senses(plan)
    examples, counts = examine(plan, senses)
    assert len(examples) == RINGS
    assert counts.shape == (len(COUNTED), 2)
    assert counts.any()
    assert all(0 <= chosen < len(columns) for ring in examples for columns, chosen in ring)
    trained = rounded(fitted(examples[0]))
    even = np.zeros_like(trained)
    assert code_length(trained, examples[0]) < code_length(start_factors()[0], examples[0])
    assert code_length(start_factors()[0], examples[0]) < 0.7 * code_length(even, examples[0])


def code_length(factors: NDArray[np.int8], examples: Sequence[Example]) -> float:
    """Return the mean bits of choices by a row of the table of factors."""
    bits = 0.0
    for columns, chosen in examples:
        logs = factors[columns].sum(axis=1, dtype=float) / LOG_UNIT
        logs[-1] = factors[columns[-1, 0]] / LOG_UNIT
        bits += np.logaddexp2.reduce(logs) - logs[chosen]
    return bits / len(examples)
