"""A radio preset in a scenario: walls weaken the radio, and the legal duty cycle applies."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deploy.run.exploration import explore
from deploy.scenario import plan as plans
from deploy.scenario.effective_radio import effective_radio
from deploy.scenario.errors import ScenarioError
from deploy.scenario.scenario import Scenario, load, parse
from netshaper.connectivity import places_of, walls_crossed
from netshaper.topology import links
from protocol.grid import FREE
from protocol.presets import MARGIN_DB, PRESETS, free_space_db

ROOMS: dict[str, Any] = {
    "map": "leader-rooms", "robots": 3, "sensor_range": 2.5, "speed": 1.0, "strategy": "meier", "bus": "memory",
}  # fmt: skip


def office(**radio: Any) -> Scenario:
    return parse({"map": "office", "map_options": {"resolution": 0.2}, "bus": "memory", "radio": radio})


@pytest.mark.parametrize("name", ["zigbee", "wifi"])
def test_two_robots_receive_each_other_where_power_walls_and_distance_allow_it(name: str) -> None:
    """A plain link budget in dBm, for random places of an office."""
    plan, link = plans.make(office(preset=name)), PRESETS[name].link
    assert link is not None
    free = np.argwhere(plan.map.cells == FREE)[:, ::-1]
    chosen = free[np.random.default_rng(7).integers(len(free), size=60)]
    cells = {robot: (int(x), int(y)) for robot, (x, y) in enumerate(chosen)}
    walls = walls_crossed(plan.map.cells, places_of(cells))
    received, out_of_range = 0, 0
    for one, peers in links(plan.radio, 1, cells).items():
        for other in cells.keys() - {one}:
            meters = max(math.dist(cells[one], cells[other]) * plan.map.resolution, 1e-9)
            loss = free_space_db(link.megahertz) + 20 * math.log10(meters)
            loss += link.db_per_wall * int(walls[one, other])
            above_db = link.power_dbm - loss - link.sensitivity_dbm - MARGIN_DB
            if abs(above_db) > 0.1:  # ranges are whole meters
                assert (other in peers) == (above_db > 0)
                received, out_of_range = received + (above_db > 0), out_of_range + (above_db < 0)
    assert received > 500
    assert out_of_range > 500


def test_a_preset_with_a_range_of_its_own_is_a_disc_as_before() -> None:
    """The run is that of a scenario that names the same figures without a preset."""
    zigbee = PRESETS["zigbee"]
    same = {"range": "4", "bandwidth": zigbee.bandwidth, "radio": {"frame_bytes": zigbee.frame_bytes}}
    digests = {
        explore(parse(ROOMS | settings), keep=False).summary["digest"]
        for settings in ({"range": "4", "radio": {"preset": "zigbee"}}, same)
    }
    assert len(digests) == 1


@pytest.mark.parametrize(
    ("given", "model", "range_", "duty_cycle"),
    [
        ({"radio": {"preset": "lora-sf9"}}, "log-distance", str(PRESETS["lora-sf9"].range_m), 0.01),
        ({"radio": "lora-sf9"}, "log-distance", str(PRESETS["lora-sf9"].range_m), 0.01),
        ({"radio": {"preset": "lora-sf9"}, "range": 12}, "disc", "12", 0.01),
        (
            {"radio": {"preset": "lora-sf9", "model": "log-distance"}, "range": 12},
            "log-distance",
            "12",
            0.01,
        ),
        ({"radio": {"preset": "lora-sf9", "model": "line-of-sight"}}, "line-of-sight", "59085", 0.01),
        ({"radio": {"preset": "lora-sf9", "duty_cycle": 1}, "range": 9}, "disc", "9", 1.0),
        ({"radio": "lora-sf9", "bandwidth": "unlimited", "range": 9}, "disc", "9", 1.0),
        ({"radio": "wifi"}, "log-distance", str(PRESETS["wifi"].range_m), 1.0),
    ],
)
def test_settings_of_the_scenario_take_precedence_over_the_preset(
    given: dict[str, Any], model: str, range_: str, duty_cycle: float
) -> None:
    scenario = parse(given)
    assert (scenario.radio.model, scenario.range, scenario.radio.duty_cycle) == (model, range_, duty_cycle)
    link = PRESETS[scenario.radio.preset].link
    assert link is not None
    assert scenario.radio.db_per_wall == (link.db_per_wall if model == "log-distance" else 6.9)
    assert parse(scenario.model_dump(mode="json")) == scenario, "a run directory keeps all settings"


def test_a_preset_from_the_command_line_replaces_the_radio_of_a_file(tmp_path: Path) -> None:
    file = tmp_path / "radio.toml"
    file.write_text(load(None, {"radio.preset": "lora-sf9"}).to_toml())
    assert load(file, {"radio.preset": "zigbee"}) == load(None, {"radio.preset": "zigbee"})
    assert load(file, {"radio": "zigbee"}) == load(None, {"radio.preset": "zigbee"})
    file.write_text('radio = "lora-sf9"\n')
    assert load(file, {"radio.loss": 0.1}).radio.preset == "lora-sf9"


@pytest.mark.parametrize(
    ("radio", "message"),
    [
        ("lora", "no radio preset is called 'lora'; did you mean"),
        (["lora-sf9", "zigbee"], "radio.preset = .*: must be one name; lists are axes of sweep, compare"),
        ({"preset": ["lora-sf9"]}, "radio.preset = .*: must be one name"),
        ({"preset": {"name": "zigbee"}}, "radio.preset = .*: must be a name"),
    ],
)
def test_unknown_presets_and_lists_of_presets_are_refused(radio: Any, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        parse({"radio": radio})


def test_the_line_about_the_radio_states_the_duty_cycle_and_its_source() -> None:
    assert "duty cycle 1 %, the limit of ETSI EN 300 220-2, 868.0 to 868.6 MHz (radio.duty_cycle=1" in (
        effective_radio(plans.make(office(preset="lora-sf9")))
    )
    off = effective_radio(plans.make(office(preset="lora-sf9", duty_cycle=1)))
    assert "no duty cycle; ETSI EN 300 220-2, 868.0 to 868.6 MHz allows 1 %" in off
    zigbee = effective_radio(plans.make(office(preset="zigbee")))
    assert "duty cycle" not in zigbee
    assert "8 dB per wall" in zigbee


def test_no_robot_sends_more_than_its_duty_cycle_allows() -> None:
    result = explore(parse(ROOMS | {"radio": {"preset": "lora-sf9", "duty_cycle": 0.0002}}), keep=False)
    rows = result.records.ledger()
    sent = np.bincount(rows["sender"], rows["bytes"] * rows["carried"])
    assert result.summary["duty_cycle"] == pytest.approx(sent.max() / PRESETS["lora-sf9"].bandwidth / 3600)
    assert 0.00015 < result.summary["duty_cycle"] <= 0.0002
    assert result.summary["undelivered"]["limit"] > 0
    assert (
        explore(parse(ROOMS | {"steps": 3, "bandwidth": "unlimited"}), keep=False).summary["duty_cycle"]
        is None
    )


def test_robots_wait_for_reports_as_long_as_frames_and_answers_may_be_under_way() -> None:
    plan = plans.make(office(delay=3, jitter=2))
    assert [settings.replication.round_trip for settings in plan.robot_settings.values()] == [
        10
    ] * plan.scenario.robots
