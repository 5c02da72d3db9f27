"""A scenario: all settings that determine the result of a run; read from TOML and validated before the run starts."""

from __future__ import annotations

import math
import os
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import tomli_w
from pydantic import Field, ValidationError, ValidationInfo, field_validator, model_validator

from agent.encoding_options import PolygonOptions, PredictiveOptions
from deploy.scenario import plugins
from deploy.scenario.finding_maps import FILES as MAP_FILES
from deploy.scenario.hardware import PRESETS, Hardware, RobotOverride, with_presets
from deploy.scenario.radio_presets import RADIO_KEYS, preset_settings
from deploy.scenario.tables import (
    MAX_INTEGER,
    MAX_TOLERANCE,
    Bandwidth,
    ChangeTable,
    Degrees,
    FaultTable,
    Meters,
    NotNegative,
    Positive,
    Range,
    Table,
    Whole,
    check_types,
    range_in_meters,
)
from netshaper.radio_options import Partition, RadioOptions
from protocol import faults
from protocol.budget import WORD_FOR_UNLIMITED, Budget
from protocol.errors import shown, there_are
from protocol.files import read_file
from protocol.grid import MAX_ROBOTS
from protocol.messages import Change, FaultEvent
from protocol.packets import MAX_GOSSIP_MAPS, MAX_MAPS
from worldsim.people_options import PeopleOptions
from worldsim.recorded.options import RecordingOptions
from worldsim.sensor_options import IDEAL, LASERS, LaserOptions, PoseOptions

SHIPPED = Path(__file__).with_name("shipped")
"""Directory of the scenarios that are installed with the code; a file name alone can refer to one."""

DEFAULT_STRATEGY = "repairmen"

PLAYBACK = "playback"
"""The strategy of recorded runs."""

RECORDED_PATIENCE = 2
"""`predictive.patience` of recorded runs."""
RECORDED_RANGE_M = 10.0
"""Default of `sensor_range` in recorded runs."""

NOT_RECORDED = (
    "map_seed", "map_options", "speed", "start", "starts", "start_jitter", "start_spacing", "motion",
    "robots_collide", "radius", "interference", "field_of_view", "scanner_turn", "laser", "pose", "people", "options",
    "finish",
)  # fmt: skip
"""Settings that only simulated robots have."""

NOT_RECORDED_REASON = (
    "has no meaning for robots that replay a log, which is what they drive and sense; omit it"
)


class ScenarioError(ValueError):
    """An invalid scenario. The message has one line per error: the key, its value and the valid values."""


class Scenario(Table):
    """All settings of a run, with their defaults. One step is one second.

    Raises
    ------
    ScenarioError
        Keys or values are wrong; the message lists all of them.
    """

    def __init__(self, **settings: Any) -> None:
        try:
            super().__init__(**plugins.with_names(settings))
        except ValidationError as error:
            raise explained(error, _KEYS) from None
        except ValueError as error:
            raise ScenarioError(str(error)) from None

    map: str = Field("office", description="a map's YAML file, or the name of a generator (murmur map list)")
    map_seed: Whole = Field(0, ge=0, le=MAX_INTEGER, description="seed of the generator")
    map_options: dict[str, Meters] = Field(
        default_factory=dict, description="parameters of the generator: resolution, width_m, ..."
    )
    robots: Whole = Field(3, ge=1, le=MAX_ROBOTS, description="number of robots")
    range: Range = Field("100%", description="communication range: meters, or % of the map's diagonal")
    bandwidth: Bandwidth = Field(1000, description="bytes per step for the whole team")
    map_encoding: str = Field(
        "predictive",
        description="map encoding: polygons, scans, cells, predictive, slam-toolbox, zstd-maps, none",
    )
    strategy: str = Field(DEFAULT_STRATEGY, description="exploration strategy (murmur strategies lists all)")
    sensor_range: Positive = Field(5.0, description="laser range, meters")
    field_of_view: Degrees = Field(360.0, gt=0, description="degrees")
    scanner_turn: Degrees = Field(
        0.0, ge=0, description="degrees that scanners turn per step; 0: full view at once"
    )
    beams: Whole = Field(360, ge=4, le=3600, multiple_of=4, description="laser beams per full turn")
    speed: Positive = Field(0.5, description="meters per step")
    seed: Whole = Field(
        0, ge=0, le=MAX_INTEGER, description="seed of the start poses and of all random draws"
    )
    bus: Literal["zenoh", "memory"] = Field(
        "zenoh", description="zenoh: one process per participant; memory: all in one process"
    )
    clock: Literal["barrier", "wall", "field"] = Field(
        "barrier",
        description="barrier: a step waits for all robots; wall: it ends on time (docs/clocks.md); field: only records "
        "of robots in the field have it (docs/field.md)",
    )
    step_s: float = Field(
        1.0, strict=True, ge=0.01, le=60.0, description="duration of a step by the wall clock, seconds"
    )
    steps: Whole = Field(10000, ge=1, le=MAX_INTEGER, description="maximum number of steps")
    start: tuple[Meters, Meters] | None = Field(
        None, description="start position, meters in the map's frame; drawn from the seed by default"
    )
    starts: tuple[tuple[Meters, Meters], ...] = Field(
        (),
        description="start positions of the first robots, meters in the map's frame; the others start around start",
    )
    start_jitter: NotNegative = Field(0.0, description="maximum random offset of the start positions, meters")
    motion: Literal["meters", "cells"] = Field(
        "meters", description="length of a diagonal step: meters: sqrt 2 cells; cells: 1 cell"
    )
    robots_collide: Annotated[bool, Field(strict=True)] = Field(
        True, description="whether robots block each other's paths and laser beams"
    )
    radius: NotNegative = Field(0.0, description="radius of the robots, which are discs, meters; 0: points")
    start_spacing: Positive = Field(0.3, description="minimum distance between start positions, meters")
    rounds: Whole = Field(2, ge=1, le=16, description="rounds of the medium per step (R)")
    dissemination: str = Field(
        default_factory=lambda given: "gossip" if given.get("map_encoding") == "predictive" else "backoff",
        description="when maps are offered (default gossip with predictive, else backoff): backoff, thesis, gossip",
    )
    digests: bool = Field(
        False,
        description="whether robots broadcast digests of their logs, which expose forged entries",
        strict=True,
    )
    forward_maps: bool = Field(True, description="whether robots also offer the maps of others", strict=True)
    interference: NotNegative = Field(0.0, description="robots closer than this hinder each other, meters")
    polygons: PolygonOptions = Field(
        default_factory=PolygonOptions, description="options of the polygon encoding"
    )
    predictive: PredictiveOptions = Field(
        default_factory=PredictiveOptions, description="options of the predictive encoding"
    )
    radio: RadioOptions = Field(default_factory=RadioOptions, description="options of the radio")
    laser: LaserOptions = Field(default_factory=LaserOptions, description="errors of the lasers")
    pose: PoseOptions = Field(
        default_factory=PoseOptions, description="errors of the poses that robots believe in"
    )
    people: PeopleOptions = Field(default_factory=PeopleOptions, description="people in the building")
    recording: RecordingOptions = Field(
        default_factory=RecordingOptions, description="logs that robots replay instead of exploring"
    )
    robot: tuple[RobotOverride, ...] = Field((), description="robots with different hardware")
    tolerance: Whole = Field(
        default_factory=lambda given: int(_is_noisy(given)),
        ge=0,
        le=MAX_TOLERANCE,
        description="cells between a wall and its copy on teammates' maps at most (default 1 with errors of lasers or "
        "poses, and of recorded ones, else 0)",
    )
    options: dict[str, Any] = Field(default_factory=dict, description="options of the strategy, by name")
    reply_timeout_s: Positive = Field(
        60.0, description="time limit for a robot's reply or move, seconds of wall clock"
    )
    min_coverage: float = Field(
        0.97,
        strict=True,
        ge=0,
        le=1,
        description="fraction of the reachable area that the team must have seen when a robot ends the run",
    )
    finish: Literal["first", "all"] = Field(
        "first", description="robots that must have finished for the run to end: the first one, or all"
    )
    fault: tuple[FaultTable, ...] = Field(
        (), description="faults of robots: breakdowns, restarts, radio failures"
    )
    change: tuple[ChangeTable, ...] = Field((), description="changes of the radio's bandwidth or range")

    @model_validator(mode="before")
    @classmethod
    def _take_preset(cls, data: Any) -> Any:
        """Fill in the radio preset's values where the scenario does not give its own."""
        radio = data.get("radio") if isinstance(data, dict) else None
        if isinstance(radio, str | list | tuple):
            radio = {"preset": radio}
        if not isinstance(radio, dict) or not radio.get("preset"):
            return data
        return data | preset_settings(data | {"radio": radio})

    @model_validator(mode="before")
    @classmethod
    def _take_sensor_presets(cls, data: Any) -> Any:
        """Fill in the values of presets of lasers and poses, of the team and of single robots."""
        if not isinstance(data, dict):
            return data
        data = with_presets(data)
        robots = data.get("robot")
        if not isinstance(robots, list | tuple):
            return data
        return data | {
            "robot": [
                with_presets(each, f"robot.{place}.") if isinstance(each, dict) else each
                for place, each in enumerate(robots)
            ]
        }

    @model_validator(mode="before")
    @classmethod
    def _take_recorded_defaults(cls, data: Any) -> Any:
        """Set the defaults of recorded runs: several logs have one robot each, and robots neither plan nor drive."""
        recording = data.get("recording") if isinstance(data, dict) else None
        files: Any
        if isinstance(recording, RecordingOptions):
            files, listeners = recording.files, recording.listeners
        else:
            table = recording if isinstance(recording, dict) else {}
            files, listeners = table.get("files"), table.get("listeners", 0)
        if not isinstance(files, list | tuple) or not files:
            return data
        defaults = {"strategy": PLAYBACK, "sensor_range": RECORDED_RANGE_M, "min_coverage": 0.0}
        if len(files) > 1 and isinstance(listeners, int):
            defaults["robots"] = len(files) + listeners
        predictive = data.get("predictive", {})
        if isinstance(predictive, dict):
            data = data | {"predictive": {"patience": RECORDED_PATIENCE} | predictive}
        return defaults | data

    @model_validator(mode="before")
    @classmethod
    def _choose_wide_seen_walls(cls, data: Any) -> Any:
        """Set the default of `polygons.wide_seen_walls`: false if the strategy observes from a distance."""
        if not isinstance(data, dict) or data.get("map_encoding") != "polygons":
            return data
        polygon = data.get("polygons", {})
        if not isinstance(polygon, dict) or "wide_seen_walls" in polygon:
            return data
        from agent.strategies.registry import strategy  # noqa: PLC0415  loads kernels, which --help does not need

        try:
            chosen = strategy(str(data.get("strategy", DEFAULT_STRATEGY)))
        except ValueError:
            return data  # `_fits_together` reports the error
        if not chosen.observes_from_distance:
            return data
        return data | {"polygons": polygon | {"wide_seen_walls": False}}

    @field_validator("robot", "fault", "change", mode="before")
    @classmethod
    def _tables_are_tables(cls, value: object, info: ValidationInfo) -> object:
        if isinstance(value, list | tuple) and all(isinstance(each, dict | Table) for each in value):
            return value
        kinds: dict[str, type[Table]] = {"robot": RobotOverride, "fault": FaultTable, "change": ChangeTable}
        kind = kinds[str(info.field_name)]
        hint = "; number of robots is `robots`" if info.field_name == "robot" else ""
        raise ValueError(f"must be tables, [[{info.field_name}]], of {', '.join(kind.model_fields)}{hint}")

    @field_validator("polygons", "predictive", "radio", "laser", "pose", "people", "recording", mode="before")
    @classmethod
    def _types_are_exact(cls, value: object, info: ValidationInfo) -> object:
        check_types(cls.model_fields[str(info.field_name)].annotation, value)
        return value

    @field_validator("map_encoding", "dissemination")
    @classmethod
    def _part_is_known(cls, value: str, info: ValidationInfo) -> str:
        plugins.kinds()[str(info.field_name)].find(value)
        return value

    @field_validator("options")
    @classmethod
    def _options_are_plain(cls, value: dict[str, Any]) -> dict[str, Any]:
        for name, option in value.items():
            if isinstance(option, int | float) and not abs(option) <= MAX_INTEGER:
                raise ValueError(f"{name} must lie between -{MAX_INTEGER} and {MAX_INTEGER}")
        return value

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        from agent.encodings.catalog import encoding_class  # noqa: PLC0415  loads numpy, which --help does not need
        from agent.strategies.registry import strategy  # noqa: PLC0415  loads kernels, which --help does not need

        strategy(self.strategy).check(self.options)
        plugins.kinds()["radio.model"].find(self.radio.model)
        self._check_recording()
        if self.clock == "barrier" and self.step_s != Scenario.model_fields["step_s"].default:
            raise ValueError(f"step_s = {self.step_s:g}: steps have a duration only with clock = 'wall'")
        if self.robots > self.most_maps and self.map_encoding != "none":
            raise ValueError(
                f"robots = {self.robots}: packets can address the maps of {self.most_maps} robots; "
                "for more, set dissemination = 'gossip' or map_encoding = 'none'"
            )
        if not self.forward_maps and self.dissemination == "gossip":
            raise ValueError("forward_maps = false: dissemination = 'gossip' forwards all maps; omit one")
        for partition in self.radio.partition:
            unknown = [robot for group in partition.groups for robot in group if robot >= self.robots]
            if unknown:
                raise ValueError(
                    f"[[radio.partition]] names robot {unknown[0]}; the last one is {self.robots - 1}"
                )
        bandwidths = [self.bandwidth, *(change.bandwidth for change in self.change)]
        if self.radio.duty_cycle < 1 and WORD_FOR_UNLIMITED in bandwidths:
            raise ValueError(
                f"radio.duty_cycle = {self.radio.duty_cycle:g}: is a share of the bandwidth, which must be limited; "
                "1 means no duty cycle"
            )
        lasers = ", ".join(name for name in LASERS if name != IDEAL)
        if not self.is_noisy and encoding_class(self.map_encoding).needs_range_scans:
            raise ValueError(
                f"map_encoding = {self.map_encoding!r}: encodes ranges in meters, which exact lasers do not have; "
                f"choose a laser.preset with errors: {lasers}"
            )
        if self.people.number and not self.is_noisy:
            raise ValueError(
                f"people.number = {self.people.number}: with exact lasers, a person would stay on maps as a wall; "
                f"choose a laser.preset with errors: {lasers}"
            )
        for hardware in map(self.body_of, range(self.robots)):
            if hardware.laser.rate < 1 and hardware.scanner_turn:
                raise ValueError(
                    f"laser.rate = {hardware.laser.rate:g}: a turning scanner (scanner_turn) measures in every step"
                )
        if self.start_jitter and self.start is None and not self.starts:
            raise ValueError("start_jitter: offsets a given start position: set start or starts")
        numbers = [entry.robot for entry in self.robot]
        for number in numbers:
            if number >= self.robots:
                raise ValueError(f"[[robot]] names robot {number}; the last one is {self.robots - 1}")
        if len(set(numbers)) < len(numbers):
            raise ValueError(f"[[robot]] names a robot twice: {numbers}")
        faults.check(self.faults, self.robots)
        check_incarnations(self, faults.incarnations(self.faults))
        return self

    def _check_recording(self) -> None:
        """Raise ValueError if settings of recorded and of simulated runs are combined."""
        files = self.recording.files
        if not files:
            if self.strategy == PLAYBACK:
                raise ValueError(f"strategy = {PLAYBACK!r}: replays logs: set recording.files (murmur play)")
            return
        if self.strategy != PLAYBACK:
            raise ValueError(f"strategy = {self.strategy!r}: robots that replay a log do not plan; omit it")
        listeners = self.recording.listeners
        if listeners >= self.robots:
            raise ValueError(
                f"recording.listeners = {listeners}: one robot must replay the log; set robots to {listeners + 1} "
                "or more"
            )
        if 1 < len(files) != self.robots - listeners:
            but = f", and {listeners} have none" if listeners else ""
            raise ValueError(
                f"robots = {self.robots}: each of {len(files)} logs has one robot{but}; give one log, or as many "
                "as robots"
            )
        defaults = Scenario()
        for name in NOT_RECORDED:
            if getattr(self, name) != getattr(defaults, name):
                raise ValueError(f"{name} = {shown(getattr(self, name))}: {NOT_RECORDED_REASON}")
        for entry in self.robot:
            if entry.changes_body:
                raise ValueError(f"[[robot]] {entry.robot}: {NOT_RECORDED_REASON}")

    @property
    def step_ns(self) -> int | None:
        """Duration of a step in nanoseconds; None: steps wait for all robots."""
        return round(1e9 * self.step_s) if self.clock == "wall" else None

    @property
    def is_recorded(self) -> bool:
        """Whether robots replay logs."""
        return bool(self.recording.files)

    @property
    def is_field(self) -> bool:
        """Whether this is a record of robots in the field, which cannot be run."""
        return self.clock == "field"

    @property
    def faults(self) -> tuple[FaultEvent, ...]:
        """The scheduled faults, by step."""
        return tuple(sorted(fault.event for fault in self.fault))

    @property
    def is_noisy(self) -> bool:
        """Whether lasers or poses have errors, as those of real robots have."""
        return self.is_field or _is_noisy(dict(self))

    def range_m(self, diagonal_m: float) -> float:
        """Return the communication range in meters, on a map with this diagonal in meters."""
        return range_in_meters(self.range, diagonal_m)

    def changes(self, diagonal_m: float) -> tuple[Change, ...]:
        """Return the changes of the radio by step, in the form of messages; `diagonal_m` is the map's, in meters."""
        return tuple(
            Change(
                each.step,
                None if each.bandwidth is None else Budget.parse(each.bandwidth),
                None if each.range is None else round(1000 * range_in_meters(each.range, diagonal_m)),
            )
            for each in sorted(self.change, key=lambda each: each.step)
        )

    def body_of(self, number: int) -> Hardware:
        """Return the hardware of one robot."""
        own = next((entry for entry in self.robot if entry.robot == number), RobotOverride(robot=number))
        return Hardware(
            robot=number,
            sensor_range=own.sensor_range or self.sensor_range,
            field_of_view=own.field_of_view or self.field_of_view,
            speed=own.speed or self.speed,
            send_bytes=own.send_bytes or self.radio.send_bytes,
            receive_bytes=own.receive_bytes or self.radio.receive_bytes,
            radius=self.radius if own.radius is None else own.radius,
            scanner_turn=self.scanner_turn if own.scanner_turn is None else own.scanner_turn,
            laser=own.laser or self.laser,
            pose=own.pose or self.pose,
        )

    @property
    def most_maps(self) -> int:
        """Number of maps that packets can address; offers have fewer bits for the map than gossip packets."""
        return MAX_GOSSIP_MAPS if self.dissemination == "gossip" else MAX_MAPS

    def to_toml(self) -> str:
        """Return the scenario as TOML, with all settings."""
        return tomli_w.dumps(self.model_dump(mode="json", exclude_none=True))


def check_incarnations(scenario: Scenario, incarnations: int) -> None:
    """Raise ScenarioError if packets cannot address one map per start of each robot (`agent.identity`)."""
    most = scenario.most_maps
    if scenario.map_encoding != "none" and scenario.robots * incarnations > most:
        raise ScenarioError(
            f"robots = {scenario.robots}: packets can address {most} maps, one per start of each robot; "
            f"{scenario.robots} robots can start {most // scenario.robots} times each, not {incarnations} times"
        )


def load(path: Path | None, overrides: dict[str, Any]) -> Scenario:
    """Read a scenario file (None: only defaults) and apply the overrides that are not None.

    A file name alone that does not exist refers to a shipped scenario. The path of a map is relative to the file
    that names it. An override of ``table.key`` leaves the table's other keys as they are.

    Raises ScenarioError if the file cannot be read, or a key or value is wrong.
    """
    data: dict[str, Any] = {}
    if path is not None:
        path, data = read_toml(path, "scenario", SHIPPED)
        if "map" in data:
            data["map"] = beside(path, data["map"])
        recording = data.get("recording")
        if isinstance(recording, dict) and isinstance(recording.get("files"), list):
            data["recording"] = recording | {
                "files": [str(path.parent / str(name)) for name in recording["files"]]
            }
    remove_preset_keys(data, overrides)
    where = f"scenario {path}" if path is not None else "scenario"
    lay(data, {key: value for key, value in overrides.items() if value is not None}, where)
    return parse(data, where)


NAMED = ("radio", *PRESETS)
"""Tables that a name can stand for: that of a preset."""


def remove_preset_keys(data: dict[str, Any], overrides: dict[str, Any]) -> None:
    """Remove the settings that presets from the overrides replace."""
    if overrides.get("radio.preset") or isinstance(overrides.get("radio"), str):
        for key in ("bandwidth", "range"):
            data.pop(key, None)
        if isinstance(data.get("radio"), dict):
            data["radio"] = {key: value for key, value in data["radio"].items() if key not in RADIO_KEYS}
    for table, presets in PRESETS.items():
        if name := overrides.get(f"{table}.preset") or overrides.get(table):
            data.pop(table, None)
            if "field_of_view" in presets.get(str(name), {}):
                data.pop("field_of_view", None)


def lay(data: dict[str, Any], settings: dict[str, Any], where: str) -> None:
    """Lay settings over others; a dotted name (``options.beta``) sets one key of a table.

    A name as the value of ``radio``, ``laser``, or ``pose`` sets its ``preset``.

    Raises ScenarioError, which begins with `where`, if a dotted name refers to a key of something else than a table.
    """
    for name, value in settings.items():
        key = f"{name}.preset" if name in NAMED and isinstance(value, str) else name
        table, dot, inner = key.partition(".")
        if dot:
            keys = data.get(table, {})
            if table in NAMED and isinstance(keys, str):
                keys = {"preset": keys}
            if not isinstance(keys, dict):
                raise ScenarioError(
                    f"{where}: {table} = {keys!r}: must be a table, for {key!r} sets a key of it"
                )
            data[table] = {**keys, inner: value}
        else:
            data[key] = value


def read_toml(path: Path, kind: str, shipped: Path | None = None) -> tuple[Path, dict[str, Any]]:
    """Read a TOML file; return its path and its content. Error messages name its `kind`, for example a scenario.

    A file name alone that does not exist refers to a file in the directory `shipped`, if that is given.

    Raises ScenarioError if the file cannot be read, or is not TOML.
    """
    if shipped and len(path.parts) == 1 and not path.exists() and (shipped / path.name).exists():
        path = shipped / path.name
    try:
        return path, tomllib.loads(read_file(path).decode("utf-8-sig"))
    except RecursionError:
        raise ScenarioError(f"{kind} {path}: is nested too deeply") from None
    except FileNotFoundError:
        names = [file.name for file in shipped.glob("*.toml")] if shipped else []
        others = f", and no shipped {kind}; {there_are(sorted(names), path.name)}" if names else ""
        setting = f"; to change a setting: --set {path}" if "=" in path.name else ""
        raise ScenarioError(f"{kind} {path}: no such file{others}{setting}") from None
    except OSError as error:
        raise ScenarioError(f"{kind} {path}: {error.strerror or error}") from None
    except ValueError as error:
        raise ScenarioError(f"{kind} {path}: not TOML: {error}") from None


def beside(path: Path, named: Any) -> Any:
    """Return the path of the map `named` in the file `path`; the name of a generator is returned unchanged.

    A map file is searched in the directory of `path`, then in the directory of the environment variable MURMUR_MAPS.
    """
    if not isinstance(named, str) or not named.endswith(MAP_FILES):
        return named
    elsewhere = Path(os.environ.get("MURMUR_MAPS", "")) / named
    is_there = not (path.parent / named).exists() and elsewhere.exists()
    return str(elsewhere if is_there else path.parent / named)


def _is_noisy(given: Mapping[str, Any]) -> bool:
    """Return whether any robot's laser or pose has errors, by the valid settings of a scenario, or it is recorded."""
    robots: tuple[RobotOverride, ...] = given.get("robot", ())
    laser, pose = given.get("laser", LaserOptions()), given.get("pose", PoseOptions())
    lasers, poses = [each.laser or laser for each in robots], [each.pose or pose for each in robots]
    if len(robots) < given.get("robots", math.inf):
        lasers, poses = [*lasers, laser], [*poses, pose]
    is_exact = all(each.is_ideal for each in lasers) and all(each.is_exact for each in poses)
    return not is_exact or bool(given.get("recording", RecordingOptions()).files)


def parse(data: dict[str, Any], where: str = "scenario") -> Scenario:
    """Validate a scenario given as a dictionary; `where` begins each line of the error message.

    Raises ScenarioError if keys or values are wrong; the message lists all of them.
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
    "laser": [field.name for field in fields(LaserOptions)],
    "robot.laser": [field.name for field in fields(LaserOptions)],
    "pose": [field.name for field in fields(PoseOptions)],
    "robot.pose": [field.name for field in fields(PoseOptions)],
    "people": [field.name for field in fields(PeopleOptions)],
    "recording": [field.name for field in fields(RecordingOptions)],
    "radio.partition": [field.name for field in fields(Partition)],
}
"""The valid keys of each table."""


_WORDING = {
    "Input should be": "must be",
    "a valid integer": "a whole number",
    "a valid number": "a number",
    "a valid string": "text",
    ", unable to parse string as an integer": "",
    "a valid dictionary": "a table",
    "a valid tuple": "a list",
    "a valid list": "a list",
    "a valid boolean": "true or false",
    "List should have at least 1 item after validation, not 0": "must have at least one entry",
}
"""Phrases of pydantic's messages, and our replacements."""


def explained(error: ValidationError, keys: Mapping[str, Iterable[str]]) -> ScenarioError:
    """Return one of pydantic's exceptions as a ScenarioError; `keys` are the known ones, by table."""
    errors = [item for item in error.errors() if item["type"] != "default_factory_not_called"]
    return ScenarioError("\n".join(dict.fromkeys(explain(item, keys) for item in errors)))


def explain(item: Any, keys: Mapping[str, Iterable[str]]) -> str:
    """Return one of pydantic's errors as a line: the key, its value and the valid values, of `keys` by table."""
    key = ".".join(str(part) for part in item["loc"] if str(part) not in _KINDS)
    message = str(item["msg"]).removeprefix("Value error, ")
    for theirs, ours in _WORDING.items():
        message = message.replace(theirs, ours)
    message = re.sub(r"a dictionary or an instance of \w+", "a table", message)
    if item["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        table = ".".join(str(part) for part in item["loc"][:-1] if isinstance(part, str))
        return f"{key}: unknown setting; {there_are(keys[table], str(item['loc'][-1]))}"
    if item["type"] == "missing":
        return f"{key} is missing"
    return f"{key} = {shown(item['input'])}: {message}" if key else message


_KINDS = ("int", "tuple", "tuple[int, ...]", "literal['unlimited']")
"""Parts of pydantic's locations that name an alternative of a value's type."""
