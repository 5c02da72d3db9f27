"""A scenario: everything that determines a run's result, as TOML, checked before anything starts."""

from __future__ import annotations

import os
import re
import tomllib
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import tomli_w
from pydantic import Field, ValidationError, ValidationInfo, field_validator, model_validator

from agent.encodings.polygon_options import PolygonOptions
from agent.encodings.predictive_options import PredictiveOptions
from deploy.scenario.finding_maps import FILES as MAP_FILES
from deploy.scenario.tables import (
    MOST_INTEGER,
    UNLIMITED,
    Bandwidth,
    ChangeTable,
    Degrees,
    FaultTable,
    Meters,
    NotNegative,
    Positive,
    Range,
    RobotOverride,
    Table,
    Whole,
    range_in_metres,
)
from netshaper.presets import PRESETS
from netshaper.radio_options import Partition, RadioOptions
from protocol.budget import Budget
from protocol.errors import there_are
from protocol.grid import MAX_ROBOTS
from protocol.messages import Change, FaultEvent
from protocol.packets import MAX_GOSSIP_MAPS, MAX_MAPS
from worldsim import faults

SHIPPED = Path(__file__).with_name("shipped")
"""Scenarios that are installed with the code; they can be given by name instead of a path."""

DEFAULT_STRATEGY = "repairmen"


class ScenarioError(ValueError):
    """A scenario that cannot be run: the message names each key, its value and what would be right."""


class Scenario(Table):
    """All settings of a run, with their defaults. One step is one second.

    Raises
    ------
    ScenarioError
        A key or value is wrong; all that are wrong are named.
    """

    def __init__(self, **settings: Any) -> None:
        try:
            super().__init__(**settings)
        except ValidationError as error:
            said = [_explain(item) for item in error.errors() if item["type"] != "default_factory_not_called"]
            raise ScenarioError("\n".join(dict.fromkeys(said))) from None

    map: str = Field("office", description="a map's YAML file, or the name of a generator (murmur map list)")
    map_seed: Whole = Field(0, ge=0, le=MOST_INTEGER, description="seed of the generator")
    map_options: dict[str, Meters] = Field(
        default_factory=dict, description="parameters of the generator: resolution, width_m, ..."
    )
    robots: Whole = Field(3, ge=1, le=MAX_ROBOTS, description="how many robots explore")
    range: Range = Field("100%", description="communication range: metres, or % of the map's diagonal")
    bandwidth: Bandwidth = Field(1000, description="bytes per step for the whole team")
    map_encoding: str = Field(
        "predictive", description="how maps are encoded: polygons, scans, cells, predictive, none"
    )
    strategy: str = Field(
        DEFAULT_STRATEGY, description="how targets are chosen (murmur strategies lists all)"
    )
    sensor_range: Positive = Field(5.0, description="range of the lasers, metres")
    field_of_view: Degrees = Field(360.0, gt=0, description="degrees")
    scanner_turn: Degrees = Field(
        0.0, ge=0, description="degrees that scanners turn per step; 0: full view at once"
    )
    beams: Whole = Field(360, ge=4, le=3600, multiple_of=4, description="laser beams per full turn")
    speed: Positive = Field(0.5, description="speed of the robots, metres per step")
    seed: Whole = Field(0, ge=0, le=MOST_INTEGER, description="determines start poses and every random draw")
    bus: Literal["zenoh", "memory"] = Field("zenoh", description="processes on Zenoh, or all in one process")
    steps: Whole = Field(
        10000, ge=1, le=MOST_INTEGER, description="the run ends after this many steps at the latest"
    )
    start: tuple[Meters, Meters] | None = Field(
        None, description="metres in the map's frame; drawn from the seed if left out"
    )
    starts: tuple[tuple[Meters, Meters], ...] = Field(
        (),
        description="where the first robots start, one each, metres in the map's frame; the others around start",
    )
    start_jitter: NotNegative = Field(
        0.0, description="metres that the seed moves start, or each of starts, at most"
    )
    motion: Literal["metres", "cells"] = Field(
        "metres",
        description="how a cell's way is counted: by its length, or one cell to any of eight neighbours",
    )
    robots_collide: Annotated[bool, Field(strict=True)] = Field(
        True, description="whether robots block each other's way and laser"
    )
    radius: NotNegative = Field(0.0, description="metres; robots are discs, 0: points")
    start_spacing: Positive = Field(0.3, description="metres between start poses")
    rounds: Whole = Field(2, ge=1, le=16, description="rounds of the medium per step (R)")
    dissemination: Literal["backoff", "thesis", "gossip"] = Field(
        default_factory=lambda said: "gossip" if said.get("map_encoding") == "predictive" else "backoff",
        description="when maps are offered, by default gossip with predictive, else backoff: backoff, thesis, gossip",
    )
    forward_maps: bool = Field(True, description="whether robots offer maps of others too", strict=True)
    interference: NotNegative = Field(0.0, description="metres; nearer robots hinder each other")
    polygons: PolygonOptions = Field(
        default_factory=PolygonOptions, description="options of the polygon encoding"
    )
    predictive: PredictiveOptions = Field(
        default_factory=PredictiveOptions, description="options of the predictive encoding"
    )
    radio: RadioOptions = Field(default_factory=RadioOptions, description="options of the radio")
    options: dict[str, Any] = Field(default_factory=dict, description="options of the strategy, by name")
    reply_timeout_s: Positive = Field(
        60.0, description="seconds of wall clock in which a robot must be done with a phase or a move"
    )
    min_coverage: float = Field(
        0.9,
        ge=0,
        le=1,
        description="part of the area that must have been seen for a run to count as finished",
    )
    robot: tuple[RobotOverride, ...] = Field((), description="robots with different hardware")
    fault: tuple[FaultTable, ...] = Field(
        (), description="faults of robots: breakdowns, restarts, radio failures"
    )
    change: tuple[ChangeTable, ...] = Field(
        (), description="when the radio's bandwidth or range become others"
    )

    @model_validator(mode="before")
    @classmethod
    def _take_preset(cls, data: Any) -> Any:
        """What a preset says of the radio, where the scenario does not say it itself."""
        radio = data.get("radio") if isinstance(data, dict) else None
        if not isinstance(radio, dict) or not radio.get("preset"):
            return data
        name = radio["preset"]
        if name not in PRESETS:
            raise ValueError(f"radio.preset = {name!r}: {there_are(PRESETS, str(name))}")
        preset = PRESETS[name]
        taken = {"bandwidth": preset.bandwidth, "range": str(preset.range_m)} | data
        return taken | {"radio": {"frame_bytes": preset.frame_bytes} | radio}

    @model_validator(mode="before")
    @classmethod
    def _doubt_openings(cls, data: Any) -> Any:
        """Whether walls of outlines are wide that a robot has seen itself, where the scenario does not say it itself.

        To a strategy that looks at crumbs from afar it is cheap to find out.
        """
        if not isinstance(data, dict) or data.get("map_encoding") != "polygons":
            return data
        polygon = data.get("polygons", {})
        if not isinstance(polygon, dict) or "wide_seen_walls" in polygon:
            return data
        from agent.strategies.registry import strategy  # noqa: PLC0415  kernels, of which help needs none

        try:
            chosen = strategy(str(data.get("strategy", DEFAULT_STRATEGY)))
        except ValueError:
            return data  # `_fits_together` says why
        if not chosen.observes_from_distance:
            return data
        return data | {"polygons": polygon | {"wide_seen_walls": False}}

    @field_validator("robot", "fault", "change", mode="before")
    @classmethod
    def _tables_are_tables(cls, value: object, info: ValidationInfo) -> object:
        if isinstance(value, list | tuple) and all(isinstance(each, dict | Table) for each in value):
            return value
        kinds: dict[str, type[Table]] = {
            "robot": RobotOverride,
            "fault": FaultTable,
            "change": ChangeTable,
        }
        kind = kinds[str(info.field_name)]
        hint = "; how many robots explore is `robots`" if info.field_name == "robot" else ""
        raise ValueError(f"must be tables, [[{info.field_name}]], of {', '.join(kind.model_fields)}{hint}")

    @field_validator("map_encoding")
    @classmethod
    def _encoding_is_known(cls, value: str) -> str:
        from agent.encodings.catalog import encoding_class  # noqa: PLC0415  arrays, of which help needs none

        encoding_class(value)
        return value

    @field_validator("options")
    @classmethod
    def _options_are_plain(cls, value: dict[str, Any]) -> dict[str, Any]:
        for name, option in value.items():
            if isinstance(option, int | float) and not abs(option) <= MOST_INTEGER:
                raise ValueError(f"{name} must lie between -{MOST_INTEGER} and {MOST_INTEGER}")
        return value

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        from agent.strategies.registry import strategy  # noqa: PLC0415  kernels, of which help needs none

        strategy(self.strategy).check(self.options)
        if self.robots > self.most_maps and self.map_encoding != "none":
            raise ValueError(
                f"robots = {self.robots}: packets can name the maps of {self.most_maps} robots; "
                "more need dissemination = 'gossip', or map_encoding = 'none'"
            )
        if not self.forward_maps and self.dissemination == "gossip":
            raise ValueError(
                "forward_maps = false: with dissemination = 'gossip' whoever is nearest passes maps on; leave one out"
            )
        for partition in self.radio.partition:
            strange = [robot for group in partition.groups for robot in group if robot >= self.robots]
            if strange:
                raise ValueError(
                    f"[[radio.partition]] speaks of robot {strange[0]}; the last one is {self.robots - 1}"
                )
        bandwidths = [self.bandwidth, *(change.bandwidth for change in self.change)]
        if self.radio.duty_cycle < 1 and UNLIMITED in bandwidths:
            raise ValueError("radio.duty_cycle: is a share of the bandwidth, which must not be unlimited")
        if self.start_jitter and self.start is None and not self.starts:
            raise ValueError("start_jitter moves a start about: give `start`, or `starts`")
        numbers = [entry.robot for entry in self.robot]
        for number in numbers:
            if number >= self.robots:
                raise ValueError(f"[[robot]] names robot {number}; the last one is {self.robots - 1}")
        if len(set(numbers)) < len(numbers):
            raise ValueError(f"[[robot]] names a robot twice: {numbers}")
        faults.check(self.faults, self.robots)
        check_incarnations(self, faults.incarnations(self.faults))
        return self

    @property
    def faults(self) -> tuple[FaultEvent, ...]:
        """The scheduled faults, by step."""
        return tuple(sorted(fault.event for fault in self.fault))

    def range_m(self, diagonal_m: float) -> float:
        """Communication range in metres on a map with such a diagonal."""
        return range_in_metres(self.range, diagonal_m)

    def changes(self, diagonal_m: float) -> tuple[Change, ...]:
        """The changes of the radio, as the relay is told them."""
        return tuple(
            Change(
                each.step,
                None if each.bandwidth is None else Budget.parse(each.bandwidth),
                None if each.range is None else round(1000 * range_in_metres(each.range, diagonal_m)),
            )
            for each in sorted(self.change, key=lambda each: each.step)
        )

    def body_of(self, number: int) -> RobotOverride:
        """The hardware of one robot, with all values filled in."""
        own = next((entry for entry in self.robot if entry.robot == number), RobotOverride(robot=number))
        return RobotOverride(
            robot=number,
            sensor_range=own.sensor_range or self.sensor_range,
            field_of_view=own.field_of_view or self.field_of_view,
            speed=own.speed or self.speed,
            send_bytes=own.send_bytes or self.radio.send_bytes or None,
            receive_bytes=own.receive_bytes or self.radio.receive_bytes or None,
            radius=self.radius if own.radius is None else own.radius,
            scanner_turn=self.scanner_turn if own.scanner_turn is None else own.scanner_turn,
        )

    @property
    def most_maps(self) -> int:
        """Maps that packets can name: offers have fewer bits for it than gossip."""
        return MAX_GOSSIP_MAPS if self.dissemination == "gossip" else MAX_MAPS

    def to_toml(self) -> str:
        """The scenario as TOML, every setting written out."""
        return tomli_w.dumps(self.model_dump(mode="json", exclude_none=True))


def check_incarnations(scenario: Scenario, incarnations: int) -> None:
    """Raise ScenarioError if packets cannot name the maps of robots that begin so often (`agent.identity`)."""
    most = scenario.most_maps
    if scenario.map_encoding != "none" and scenario.robots * incarnations > most:
        raise ScenarioError(
            f"robots = {scenario.robots}: packets can name {most} maps, one a life of each robot; so "
            f"{scenario.robots} robots can begin {most // scenario.robots} times each, not {incarnations} times"
        )


def load(path: Path | None, overrides: dict[str, Any]) -> Scenario:
    """Read a scenario file (None: only defaults) and apply the overrides that are not None.

    Where there is no such file, a plain name is that of a shipped scenario. A map named in a file is looked
    for beside that file. An override of ``table.key`` leaves the table's other keys as they are.

    Raises
    ------
    ScenarioError
        The file cannot be read, or a key or value is wrong.
    """
    data: dict[str, Any] = {}
    if path is not None:
        path, data = read_toml(path, "scenario", SHIPPED)
        if "map" in data:
            data["map"] = beside(path, data["map"])
    if overrides.get("radio.preset"):
        _leave_to_preset(data)
    _lay_over(data, overrides)
    where = f"scenario {path}" if path is not None else "scenario"
    return parse(data, where)


def _leave_to_preset(data: dict[str, Any]) -> None:
    """Take out of a file's settings what the preset says that is asked for instead."""
    for key in ("bandwidth", "range"):
        data.pop(key, None)
    if isinstance(data.get("radio"), dict):
        data["radio"] = {key: value for key, value in data["radio"].items() if key != "frame_bytes"}


def _lay_over(data: dict[str, Any], overrides: dict[str, Any]) -> None:
    """Replace what the overrides set; of tables only the keys that they name (``polygons.lazy``)."""
    for key, value in overrides.items():
        table, _, inner = key.partition(".")
        if value is None:
            continue
        if inner and isinstance(data.get(table, {}), dict):
            data[table] = dict(data.get(table, {}))
            _lay_over(data[table], {inner: value})
        else:
            data[key] = value


def read_toml(path: Path, kind: str, shipped: Path | None = None) -> tuple[Path, dict[str, Any]]:
    """Read the file of a scenario or of an experiment (`kind`); return its path and its content.

    If there is no such file, a plain name refers to one in the directory `shipped`, if there is such a directory.

    Raises
    ------
    ScenarioError
        The file cannot be read, or is not TOML.
    """
    if shipped and len(path.parts) == 1 and not path.exists() and (shipped / path.name).exists():
        path = shipped / path.name
    try:
        if path.is_char_device() or path.is_block_device():
            raise ScenarioError(f"{kind} {path}: is a device, not a file")
        return path, tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except RecursionError:
        raise ScenarioError(f"{kind} {path}: is nested too deeply") from None
    except FileNotFoundError:
        names = [file.name for file in shipped.glob("*.toml")] if shipped else []
        others = f", and none of the shipped ones; {there_are(sorted(names), path.name)}" if names else ""
        setting = f"; a setting is given as --set {path}" if "=" in path.name else ""
        raise ScenarioError(f"{kind} {path}: no such file{others}{setting}") from None
    except OSError as error:
        raise ScenarioError(f"{kind} {path}: {error.strerror or error}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{kind} {path}: not TOML: {error}") from None


def beside(path: Path, named: Any) -> Any:
    """The map that a file names; a generator's name stays.

    A YAML file is looked for beside that file, then in the folder that the environment variable MURMUR_MAPS names.
    """
    if not isinstance(named, str) or not named.endswith(MAP_FILES):
        return named
    elsewhere = Path(os.environ.get("MURMUR_MAPS", "")) / named
    is_there = not (path.parent / named).exists() and elsewhere.exists()
    return str(elsewhere if is_there else path.parent / named)


def parse(data: dict[str, Any], where: str = "scenario") -> Scenario:
    """Check a scenario given as a dictionary.

    Raises
    ------
    ScenarioError
        Keys or values are wrong; the message names all of them.
    """
    try:
        return Scenario(**data)
    except ScenarioError as error:
        raise ScenarioError("\n".join(f"{where}: {line}" for line in str(error).splitlines())) from None


_KEYS = {
    "": list(Scenario.model_fields),
    "robot": list(RobotOverride.model_fields),
    "fault": list(FaultTable.model_fields),
    "change": list(ChangeTable.model_fields),
    "polygons": [field.name for field in fields(PolygonOptions)],
    "predictive": [field.name for field in fields(PredictiveOptions)],
    "radio": [field.name for field in fields(RadioOptions)],
    "radio.partition": [field.name for field in fields(Partition)],
}
"""What may be set in each table."""


_WORDS = {
    "Input should be": "must be",
    "a valid integer": "a whole number",
    "a valid number": "a number",
    "a valid string": "text",
    ", unable to parse string as an integer": "",
    "a valid dictionary": "a table",
    "a valid tuple": "a list",
}
"""What the checking library says, and how we say it."""


def _explain(item: Any) -> str:
    key = ".".join(str(part) for part in item["loc"] if part not in ("int", "literal['unlimited']"))
    message = str(item["msg"]).removeprefix("Value error, ")
    for theirs, ours in _WORDS.items():
        message = message.replace(theirs, ours)
    message = re.sub(r"a dictionary or an instance of \w+", "a table", message)
    if item["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        table = ".".join(str(part) for part in item["loc"][:-1] if isinstance(part, str))
        return f"{key} is no setting; {there_are(_KEYS[table], str(item['loc'][-1]))}"
    if item["type"] == "missing":
        return f"{key} is missing"
    return f"{key} = {item['input']!r}: {message}" if key else message
