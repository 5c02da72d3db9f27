"""Radio presets: their link budget agrees with the sources, and walls shorten the range."""

from __future__ import annotations

import math

import pytest

from protocol.presets import MARGIN_DB, PRESETS, free_space_db, wall_loss_db


def test_free_space_loss_is_that_of_friis() -> None:
    for megahertz in (868, 2400):
        wavelength_m = 299.792458 / megahertz
        assert free_space_db(megahertz) == pytest.approx(
            20 * math.log10(4 * math.pi / wavelength_m), abs=0.06
        )


def test_a_wall_loses_about_what_cost_231_measured_for_heavy_walls_and_more_at_higher_frequencies() -> None:
    assert wall_loss_db(1800) == pytest.approx(6.9, abs=0.5)
    assert wall_loss_db(868) < wall_loss_db(1800) < wall_loss_db(2400)


@pytest.mark.parametrize("name", PRESETS)
def test_at_the_range_the_power_exceeds_the_sensitivity_by_the_fade_margin(name: str) -> None:
    link = PRESETS[name].link
    assert link is not None
    for walls in range(3):
        meters = link.range_m(walls)
        loss = free_space_db(link.megahertz) + 20 * math.log10(meters) + walls * link.db_per_wall
        assert link.power_dbm - loss - link.sensitivity_dbm == pytest.approx(MARGIN_DB, abs=0.3)
    assert PRESETS[name].range_m == link.range_m()


def test_only_lora_has_a_legal_duty_cycle() -> None:
    limited = {name for name, preset in PRESETS.items() if preset.limit.duty_cycle < 1}
    assert limited == {name for name in PRESETS if name.startswith("lora")}
    assert {PRESETS[name].limit.duty_cycle for name in limited} == {0.01}
