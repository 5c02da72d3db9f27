"""A scenario: all settings that determine the result of a run; read from TOML and validated before the run starts.

A class for each group has its settings, and checks that need no other group. Here are the checks across groups. The
groups are base classes, not attributes: files, `murmur.explore`, and the command line give all settings side by side,
and defaults of one group depend on settings of others.

    `building_settings`        the map, people, and where robots start; or logs of a real building
    `team_settings`            the robots and their hardware
    `control_settings`         the strategy and the map encoding, also those of robots in the field
    `communication_settings`   the radio, and how robots offer their maps
    `run_settings`             seed, clock, end, and faults
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import tomli_w
from pydantic import Field, ValidationError, model_validator

from deploy.scenario import plugins
from deploy.scenario.building_settings import BuildingSettings
from deploy.scenario.communication_settings import CommunicationSettings
from deploy.scenario.control_settings import DEFAULT_STRATEGY, ControlSettings
from deploy.scenario.errors import ScenarioError, explained
from deploy.scenario.run_settings import RunSettings
from deploy.scenario.tables import MAX_TOLERANCE, Whole
from deploy.scenario.team_settings import TeamSettings, has_errors
from deploy.scenario.toml_files import beside, lay, read_toml, remove_preset_keys
from protocol import faults
from protocol.errors import shown
from worldsim.recorded.options import RecordingOptions, logs_of
from worldsim.sensor_options import IDEAL, LASERS

SHIPPED = Path(__file__).with_name("shipped")
"""Directory of the scenarios that are installed with the code; a file name alone can refer to one."""

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


class Scenario(RunSettings, CommunicationSettings, ControlSettings, TeamSettings, BuildingSettings):
    """All settings of a run, with their defaults. One step is one second.

    Raises ScenarioError if keys or values are wrong; the message lists all of them.
    """

    def __init__(self, **settings: Any) -> None:
        try:
            super().__init__(**plugins.plain_settings(settings))
        except ValidationError as error:
            raise explained(error, Scenario) from None
        except ValueError as error:
            raise ScenarioError(str(error)) from None

    tolerance: Whole = Field(
        default_factory=lambda given: int(_is_noisy(given)),
        ge=0,
        le=MAX_TOLERANCE,
        description="cells between a wall and its copy on teammates' maps at most (default 1 with errors of lasers or "
        "poses, and of recorded ones, else 0)",
    )

    @model_validator(mode="before")
    @classmethod
    def _take_recorded_defaults(cls, data: Any) -> Any:
        """Set the defaults of recorded runs: several logs have one robot each, and robots neither plan nor drive."""
        recording = data.get("recording") if isinstance(data, dict) else None
        if isinstance(recording, RecordingOptions):
            recording = vars(recording)
        table = recording if isinstance(recording, dict) else {}
        files, listeners = table.get("files"), table.get("listeners", 0)
        if not isinstance(files, list | tuple) or not files:
            return data
        defaults = {"strategy": PLAYBACK, "sensor_range": RECORDED_RANGE_M, "min_coverage": 0.0}
        logs = logs_of(files, str(table.get("topic", "")))
        if logs > 1 and isinstance(listeners, int):
            defaults["robots"] = logs + listeners
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

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        from agent.encodings.catalog import encoding_class  # noqa: PLC0415  loads numpy, which --help does not need

        self._check_recording()
        if self.robots > self.most_maps and self.map_encoding != "none":
            raise ValueError(
                f"robots = {self.robots}: packets can address the maps of {self.most_maps} robots; "
                "for more, set dissemination = 'gossip' or map_encoding = 'none'"
            )
        for partition in self.radio.partition:
            unknown = [robot for group in partition.groups for robot in group if robot >= self.robots]
            if unknown:
                raise ValueError(
                    f"[[radio.partition]] names robot {unknown[0]}; the last one is {self.robots - 1}"
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
        faults.check(self.faults, self.robots)
        check_incarnations(self, faults.incarnations(self.faults))
        return self

    def _check_recording(self) -> None:
        """Raise ValueError if settings of recorded and of simulated runs are combined."""
        logs = len(self.recording.sources)
        if not logs:
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
        if 1 < logs != self.robots - listeners:
            but = f", and {listeners} have none" if listeners else ""
            raise ValueError(
                f"robots = {self.robots}: each of {logs} logs has one robot{but}; give one log, or as many "
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
    def is_noisy(self) -> bool:
        """Whether lasers or poses have errors, as those of real robots have."""
        return self.is_field or _is_noisy(dict(self))

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


def load(path: Path | str | None, overrides: Mapping[str, Any] | None = None) -> Scenario:
    """Read a scenario file (None: only defaults) and apply the overrides that are not None.

    A file name alone that does not exist refers to a shipped scenario. The path of a map is relative to the file
    that names it. An override of ``table.key`` leaves the table's other keys as they are.

    Raises ScenarioError if the file cannot be read, or a key or value is wrong.
    """
    data: dict[str, Any] = {}
    if path is not None:
        path, data = read_toml(Path(path), "scenario", SHIPPED)
        if "map" in data:
            data["map"] = beside(path, data["map"])
        recording = data.get("recording")
        if isinstance(recording, dict) and isinstance(recording.get("files"), list):
            data["recording"] = recording | {
                "files": [str(path.parent / str(name)) for name in recording["files"]]
            }
    given = {key: value for key, value in (overrides or {}).items() if value is not None}
    remove_preset_keys(data, given)
    where = f"scenario {path}" if path is not None else "scenario"
    lay(data, given, where)
    return parse(data, where)


def _is_noisy(given: Mapping[str, Any]) -> bool:
    """Return whether any robot's laser or pose has errors, by the valid settings of a scenario, or it is recorded."""
    return has_errors(given) or bool(given.get("recording", RecordingOptions()).files)


def parse(data: dict[str, Any], where: str = "scenario") -> Scenario:
    """Validate a scenario given as a dictionary; `where` begins each line of the error message.

    Raises ScenarioError if keys or values are wrong; the message lists all of them.
    """
    try:
        return Scenario(**data)
    except ScenarioError as error:
        raise error.within(where) from None
