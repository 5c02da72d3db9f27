"""The initial model of tiles is trained on the maps that robots make in an exploration."""

from __future__ import annotations

from agent.predictive import block_tiles, tiles
from agent.predictive.mixer import new_model
from deploy.run.recording_bus import record_senses
from deploy.study.tile_table import ENCODERS, LEAST_SEEN, OLDEST_START, SENSORS, shortened, train_on
from tests.system.team import small_plan


def test_a_model_learns_from_an_exploration() -> None:
    plan = small_plan("office", robots=2, map_encoding="scans", bandwidth="unlimited", steps=40, **SENSORS[0])
    senses = record_senses(plan)
    cells = tiles.CONTEXTS, tiles.SETS
    blocks = block_tiles.CONTEXTS, block_tiles.SETS
    for encoder, sizes in (
        (ENCODERS["cells"][0], cells),
        (ENCODERS["cells"][1], cells),
        (ENCODERS["blocks"][0], blocks),
    ):
        model, first = train_on(plan, senses, encoder, new_model(*sizes))
        assert first > 100
        ages = shortened(model)[1]
        assert ages.max() == OLDEST_START
        assert ages[ages > 0].min() >= LEAST_SEEN
        _, again = train_on(plan, senses, encoder, shortened(model))
        assert again < 0.8 * first
