"""Scenarios: they are read back as written, and errors name the setting, its place and the valid values."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.encoding_options import PolygonOptions
from agent.encodings.catalog import ENCODINGS
from agent.replication.engine import DISSEMINATIONS
from agent.strategies.meier import Meier
from deploy.scenario.errors import ScenarioError
from deploy.scenario.scenario import SHIPPED, Scenario, load, parse
from protocol.budget import WORD_FOR_UNLIMITED
from protocol.grid import MAX_ROBOTS
from protocol.packets import MAX_MAPS
from tests.agent.encodings.names import EXACT

MOST = 2**31 - 1

meters = st.floats(0.001, 1e6)


@st.composite
def scenarios(draw: st.DrawFn) -> dict[str, Any]:
    """Any valid settings, some of them left out."""
    map_encoding = draw(st.sampled_from(sorted(EXACT)))
    robots = draw(st.integers(1, MAX_ROBOTS if map_encoding == "none" else MAX_MAPS))
    number = st.integers(0, robots - 1)
    override = st.fixed_dictionaries(
        {"robot": number},
        optional={"sensor_range": meters, "field_of_view": st.floats(0.1, 360), "speed": meters},
    )
    death = st.fixed_dictionaries({"robot": number, "step": st.integers(1, MOST), "kind": st.just("death")})
    whole = st.integers(0, MOST)
    settings: dict[str, st.SearchStrategy[Any]] = {
        "map": st.text(st.characters(codec="utf-8", exclude_characters="\x00"), max_size=20),
        "map_seed": whole,
        "range": meters.map(str) | meters.map(lambda share: f"{share}%") | meters | st.integers(0, 10**6),
        "bandwidth": whole | st.just(WORD_FOR_UNLIMITED),
        "sensor_range": meters,
        "field_of_view": st.floats(0.1, 360),
        "beams": st.integers(1, 900).map(lambda quarter: 4 * quarter),
        "speed": meters,
        "seed": whole,
        "bus": st.sampled_from(("zenoh", "memory")),
        "steps": st.integers(1, MOST),
        "start": st.tuples(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6)).map(list),
        "radius": st.floats(0, 1e6),
        "start_spacing": meters,
        "rounds": st.integers(1, 16),
        "dissemination": st.sampled_from(("backoff", "thesis")),
        "interference": st.floats(0, 1e6),
        "options": st.fixed_dictionaries({}, optional={"small_frontier": st.floats(0, 100)}),
        "robot": st.lists(override, max_size=3, unique_by=lambda entry: entry["robot"]),
        "fault": st.lists(death, max_size=3, unique_by=lambda entry: entry["robot"]),
    }
    return {
        "robots": robots,
        "map_encoding": map_encoding,
        **draw(st.fixed_dictionaries({}, optional=settings)),
    }


@given(scenarios())
def test_a_scenario_written_out_is_read_back_the_same(settings: dict[str, Any]) -> None:
    scenario = parse(settings)
    assert parse(tomllib.loads(scenario.to_toml())) == scenario


@given(scenarios())
def test_every_setting_is_as_it_was_given(settings: dict[str, Any]) -> None:
    scenario = parse(settings)
    for key in ("robots", "seed", "sensor_range", "speed", "bandwidth", "beams", "map", "steps"):
        if key in settings:
            assert getattr(scenario, key) == settings[key]


def test_all_settings_have_valid_defaults_and_a_description() -> None:
    scenario = parse({})
    assert scenario == Scenario()
    assert scenario.robots == 3
    assert all(field.description for field in Scenario.model_fields.values())


WRONG = [
    ({"robots": 0}, "robots = 0: .*greater than or equal to 1"),
    ({"robots": 257}, "robots = 257: .*less than or equal to 256"),
    (
        {"robots": 65, "map_encoding": "polygons"},
        "robots = 65: packets can address the maps of 64 robots; for more, set dissemination = 'gossip'",
    ),
    ({"robots": True}, "robots = True: must be a whole number"),
    ({"robots": 2.5}, "robots = 2.5: must be a whole number"),
    ({"robots": "three"}, "robots = 'three': must be a whole number"),
    ({"robots": -(10**30)}, "robots = -10+: .*greater than or equal to 1"),
    ({"seed": -1}, "seed = -1: "),
    ({"seed": 2**70}, "seed = .*less than or equal to 2147483647"),
    ({"map_seed": 2**70}, "map_seed = "),
    ({"steps": 0}, "steps = 0: "),
    ({"steps": 2**31}, "steps = .*less than or equal to 2147483647"),
    ({"beams": 6}, "beams = 6: .*multiple of 4"),
    ({"beams": 0}, "beams = 0: "),
    ({"beams": 3604}, "beams = 3604: .*less than or equal to 3600"),
    ({"rounds": 0}, "rounds = 0: "),
    ({"rounds": 17}, "rounds = 17: "),
    ({"speed": 0}, "speed = 0: .*greater than 0"),
    ({"speed": math.nan}, "speed = nan: "),
    ({"speed": math.inf}, "speed = inf: "),
    ({"speed": 1e308}, "speed = 1e.308: .*less than or equal to 1000000"),
    ({"speed": True}, "speed = True: .*number"),
    ({"speed": "fast"}, "speed = 'fast': .*number"),
    ({"sensor_range": -1.0}, "sensor_range = -1.0: "),
    ({"field_of_view": 361}, "field_of_view = 361: .*360"),
    ({"field_of_view": 0}, "field_of_view = 0: "),
    ({"start_spacing": 0}, "start_spacing = 0: "),
    ({"radius": -0.1}, "radius = -0.1: "),
    ({"radius": math.nan}, "radius = nan: "),
    ({"interference": math.inf}, "interference = inf: "),
    ({"start": [1.0]}, "start.1 is missing"),
    ({"start": [1.0, math.nan]}, "start.1 = nan: "),
    ({"start": [1.0, 1e300]}, "start.1 = 1e.300: "),
    ({"start": "here"}, "start = 'here': "),
    ({"bandwidth": -1}, "bandwidth = -1: must be a whole number of bytes .*'unlimited'"),
    ({"bandwidth": 2**31}, "bandwidth = 2147483648: must be a whole number"),
    ({"bandwidth": 1000.5}, "bandwidth = 1000.5: must be a whole number"),
    ({"bandwidth": True}, "bandwidth = True: must be a whole number"),
    ({"bandwidth": "lots"}, "bandwidth = 'lots': must be .*'unlimited'"),
    ({"bandwidth": "-5"}, "bandwidth = '-5': must be"),
    ({"bandwidth": None}, "bandwidth = None: must be"),
    ({"range": "far"}, "range = 'far': must be a distance .*30%"),
    ({"range": "-1"}, "range = '-1': must be"),
    ({"range": "%"}, "range = '%': must be"),
    ({"range": "nan"}, "range = 'nan': must be"),
    ({"range": "inf"}, "range = 'inf': must be"),
    ({"range": math.inf}, "range = inf: must be"),
    ({"range": True}, "range = True: "),
    (
        {"map_encoding": "smoke"},
        "map_encoding = 'smoke': no map encoding is called 'smoke'; there are: .*scans",
    ),
    ({"strategy": "best"}, "no strategy is called 'best'; there are: .*meier"),
    ({"strategy": "é" * 400}, "no strategy is called"),
    ({"dissemination": "never"}, "dissemination = 'never': .*there are: backoff, thesis, gossip;"),
    ({"radio": {"model": "disk"}}, "no radio model is called 'disk'; did you mean disc"),
    ({"radio": {"preset": "wify"}}, "no radio preset is called 'wify'; did you mean wifi"),
    ({"bus": "tram"}, "bus = 'tram': .*'zenoh' or 'memory'"),
    ({"map": 3}, "map = 3: must be text"),
    ({"options": {"gamma": 1.0}}, "repairmen has no option 'gamma'; there are: .*small_frontier"),
    (
        {"options": {"small_frontier": "big"}},
        "option small_frontier of repairmen must be a number, not 'big'",
    ),
    ({"options": {"beta": math.nan}}, "options = .*beta must lie between"),
    ({"options": 3}, "options = 3: "),
    ({"colour": "red"}, "colour: unknown setting; there are: map, .*fault"),
    ({"polygons": {"colour": "red"}}, "polygons.colour: unknown setting; there are: medium_use"),
    ({"robot": [{"robot": 3}]}, r"\[\[robot\]\] names robot 3; the last one is 2"),
    ({"robot": [{"robot": 1}, {"robot": 1}]}, r"\[\[robot\]\] names a robot twice"),
    ({"robot": [{"robot": 1, "colour": "red"}]}, "robot.0.colour: unknown setting; there are: robot, "),
    ({"robot": [{"speed": 1.0}]}, "robot.0.robot is missing"),
    ({"robot": [{"robot": 0, "speed": -1.0}]}, "robot.0.speed = -1.0: "),
    ({"robot": {"robot": 0}}, "robot = "),
    ({"fault": [{"robot": 0, "step": 0, "kind": "death"}]}, "fault.0.step = 0: .*greater than or equal to 1"),
    (
        {"fault": [{"robot": 9, "step": 1, "kind": "death"}]},
        "fault at step 1: death of robot 9: the last robot is 2",
    ),
    ({"fault": [{"robot": 0, "kind": "death"}]}, "fault.0.step is missing"),
    ({"fault": 3}, "fault = 3: "),
]


@pytest.mark.parametrize(("settings", "complaint"), WRONG, ids=lambda value: str(value)[:60])
def test_an_error_names_the_setting_and_the_valid_values(settings: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ScenarioError, match=rf"^scenario: {complaint}"):
        parse(settings)


@given(st.dictionaries(st.sampled_from([*Scenario.model_fields, "colour"]), st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
), max_size=4))  # fmt: skip
def test_any_invalid_settings_are_a_scenario_error(settings: dict[str, Any]) -> None:
    try:
        scenario = parse(settings)
    except ScenarioError as error:
        assert str(error).startswith("scenario: ")
    else:
        assert parse(tomllib.loads(scenario.to_toml())) == scenario


def test_all_errors_are_reported_at_once() -> None:
    with pytest.raises(ScenarioError) as caught:
        parse({"robots": 0, "speed": -1.0, "colour": "red"})
    assert [line.split()[1].rstrip(":") for line in str(caught.value).splitlines()] == [
        "robots",
        "speed",
        "colour",
    ]


@pytest.mark.parametrize(
    ("range_", "wanted"),
    [
        ("100%", 50.0),
        ("30%", 15.0),
        (" 30 % ", 15.0),
        ("12.5", 12.5),
        (0, 0.0),
        (7, 7.0),
        (12.3456789, 12.3456789),
    ],
)
def test_a_range_is_meters_or_a_share_of_the_diagonal(range_: object, wanted: float) -> None:
    assert parse({"range": range_}).range_m(50.0) == pytest.approx(wanted, abs=1e-12)


@pytest.mark.parametrize(
    ("given_", "wanted"), [("1000", 1000), (" 250 ", 250), (0, 0), (WORD_FOR_UNLIMITED, WORD_FOR_UNLIMITED)]
)
def test_a_bandwidth_is_a_number_of_bytes_or_unlimited(given_: object, wanted: object) -> None:
    assert parse({"bandwidth": given_}).bandwidth == wanted


def test_a_robot_with_overrides_keeps_its_other_settings() -> None:
    scenario = parse({"speed": 0.4, "sensor_range": 3.0, "robot": [{"robot": 1, "speed": 1.0}]})
    assert [(body.sensor_range, body.speed) for body in map(scenario.body_of, range(3))] == [
        (3.0, 0.4),
        (3.0, 1.0),
        (3.0, 0.4),
    ]


def test_a_robot_has_the_laser_and_the_field_of_view_of_its_preset() -> None:
    robots = [
        {"robot": 0, "laser": "sick-lms"},
        {"robot": 1, "laser": {"preset": "rplidar-a1", "missing": 0.5}, "field_of_view": 90.0},
        {"robot": 2, "pose": "graph-slam"},
    ]
    scenario = parse({"robots": 4, "robot": robots, "laser": {"range_error_m": 0.5}})
    bodies = [scenario.body_of(robot) for robot in range(4)]
    assert [body.field_of_view for body in bodies] == [270.0, 90.0, 360.0, 360.0]
    assert [body.laser.range_error_m for body in bodies] == [0.012, 0.01, 0.5, 0.5]
    assert [body.laser.missing for body in bodies] == [0.003, 0.5, 0.0, 0.0]
    assert [body.pose.position_error_m for body in bodies] == [0.0, 0.0, 0.03, 0.0]
    assert parse(tomllib.loads(scenario.to_toml())) == scenario


@pytest.mark.parametrize(
    ("settings", "noisy"),
    [
        ({"robot": [{"robot": 1, "laser": "sick-lms"}]}, True),
        ({"robot": [{"robot": 1, "pose": "graph-slam"}]}, True),
        ({"robot": [{"robot": 1, "laser": "ideal"}]}, False),
        ({"robot": [{"robot": 1, "laser": "ideal"}], "laser": "sick-lms"}, True),
        ({"robots": 1, "robot": [{"robot": 0, "laser": "ideal"}], "laser": {"preset": "sick-lms"}}, False),
    ],
)
def test_maps_have_a_tolerance_if_any_robot_has_a_laser_or_pose_with_errors(
    settings: dict[str, Any], noisy: bool
) -> None:
    scenario = parse(settings)
    assert (scenario.is_noisy, scenario.tolerance) == (noisy, int(noisy))


def write(folder: Path, text: str) -> Path:
    path = folder / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_overrides_replace_the_file_s_values_and_the_file_s_the_defaults(tmp_path: Path) -> None:
    path = write(tmp_path, 'robots = 5\nspeed = 0.25\nmap = "office"')
    scenario = load(path, {"robots": 2, "seed": None, "range": "10%"})
    assert (scenario.robots, scenario.speed, scenario.range, scenario.seed) == (2, 0.25, "10%", 0)


def test_a_map_file_that_is_not_beside_the_scenario_is_found_in_the_map_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    maps, mine = tmp_path / "maps", tmp_path / "mine"
    maps.mkdir()
    mine.mkdir()
    (maps / "house.yaml").touch()
    monkeypatch.setenv("MURMUR_MAPS", str(maps))
    assert Path(load(write(mine, 'map = "house.yaml"'), {}).map) == maps / "house.yaml"
    (mine / "house.yaml").touch()
    assert Path(load(write(mine, 'map = "house.yaml"'), {}).map) == mine / "house.yaml"


def test_a_map_file_is_found_beside_the_scenario(tmp_path: Path) -> None:
    path = write(tmp_path, 'map = "maps/house.yaml"')
    assert Path(load(path, {}).map) == tmp_path / "maps" / "house.yaml"
    assert load(path, {"map": "elsewhere.yaml"}).map == "elsewhere.yaml"
    assert load(write(tmp_path, 'map = "/maps/house.yaml"'), {}).map == "/maps/house.yaml"
    assert load(write(tmp_path, 'map = "office"'), {}).map == "office"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("robots = ", "not TOML"),
        ("robots = 3\nrobots = 4", "not TOML"),
        ("[robots", "not TOML"),
        ("robots = 0", "robots = 0"),
        ("start = 1979-05-27", "start = "),
        ("speed = nan", "speed = nan"),
    ],
)
def test_an_invalid_file_is_named(tmp_path: Path, text: str, complaint: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(ScenarioError, match=rf"^scenario {path}: {complaint}"):
        load(path, {})


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(
        ScenarioError,
        match=r"none.toml: no such file, and no shipped scenario; there are: .*office.toml",
    ):
        load(tmp_path / "none.toml", {})
    with pytest.raises(ScenarioError, match=rf"scenario {tmp_path}: "):
        load(tmp_path, {})
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ScenarioError, match=r"binary.toml: not TOML"):
        load(binary, {})


@pytest.mark.parametrize("path", sorted(SHIPPED.glob("*.toml")), ids=lambda path: path.stem)
def test_shipped_scenarios_are_found_by_name_and_valid(path: Path) -> None:
    assert load(Path(path.name), {}) == load(path, {})


def test_invalid_flags_without_a_file_are_explained() -> None:
    with pytest.raises(ScenarioError, match=r"^scenario: robots = 0"):
        load(None, {"robots": 0})


def test_help_names_every_map_encoding_and_every_dissemination() -> None:
    fields = Scenario.model_fields
    assert str(fields["map_encoding"].description).endswith(": " + ", ".join(ENCODINGS))
    assert str(fields["dissemination"].description).endswith(": " + ", ".join(DISSEMINATIONS))
    for policy in DISSEMINATIONS:
        assert parse({"dissemination": policy}).dissemination == policy


def test_strategies_that_observe_from_a_distance_disable_wide_walls_by_default(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def wide(**settings: Any) -> bool:
        return parse({"map_encoding": "polygons"} | settings).polygons.wide_seen_walls

    assert not wide()
    assert not wide(strategy="repairmen", polygons={"lazy": False})
    assert wide(polygons={"wide_seen_walls": True})
    assert wide(strategy="meier")
    assert not wide(strategy="meier", polygons={"wide_seen_walls": False})
    assert Scenario(map_encoding="polygons", polygons=PolygonOptions()).polygons.wide_seen_walls
    monkeypatch.setattr(Meier, "observes_from_distance", True)
    assert not wide(strategy="meier")
