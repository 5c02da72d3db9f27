"""The initial model of narrow media is trained on the poses of an exploration."""

from __future__ import annotations

import numpy as np

from agent.predictive.pose_model import RINGS, start_factors
from deploy.run.recording_bus import record_run
from deploy.study.narrow_table import COUNTED, code_length, examine, fitted, rounded
from tests.system.team import small_plan


def test_factors_learn_from_an_exploration() -> None:
    plan = small_plan("office", robots=2, map_encoding="scans", bandwidth="unlimited", steps=40)
    senses = [bus.senses for bus in record_run(plan, ["r0", "r1"])[0].values()]
    examples, counts = examine(plan, senses)
    assert len(examples) == RINGS
    assert counts.shape == (len(COUNTED), 2)
    assert counts.any()
    assert all(0 <= chosen < len(columns) for ring in examples for columns, chosen in ring)
    trained = rounded(fitted(examples[0]))
    even = np.zeros_like(trained)
    assert code_length(trained, examples[0]) < code_length(start_factors()[0], examples[0])
    assert code_length(start_factors()[0], examples[0]) < 0.7 * code_length(even, examples[0])
