"""The settings of a robot in the field, read from a TOML file and validated before anything is opened."""

from __future__ import annotations

import math
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError, model_validator

from agent.radios.options import LinkOptions
from deploy.scenario.control_settings import ControlSettings
from deploy.scenario.errors import ScenarioError, explained
from deploy.scenario.tables import (
    MAX_INTEGER,
    Meters,
    NotNegative,
    Positive,
    Table,
    Whole,
    check_numbers,
    exact,
)
from deploy.scenario.toml_files import read_toml
from protocol.grid import MAX_ROBOTS, MAX_SIDE
from protocol.nanoseconds import SECOND
from protocol.packets import MAX_GOSSIP_MAPS
from protocol.range_scans import MAX_REACH_M
from protocol.ros2.names import check_node, qualified

EXAMPLE = Path(__file__).with_name("robot.toml")
"""The commented settings file that `murmur robot --example` prints."""

Seconds = Annotated[float, Field(strict=True, gt=0, le=86400)]
Turn = Annotated[float, Field(strict=True, ge=-360, le=360)]


class GridTable(Table):
    """The team's grid in the common frame; it must cover the whole building, and be equal on all robots."""

    x: Meters = Field(description="left edge, meters")
    y: Meters = Field(description="lower edge, meters")
    width_m: Positive = Field(description="extent along x, meters")
    height_m: Positive = Field(description="extent along y, meters")
    resolution: Positive = Field(0.1, description="side of a cell, meters")

    @property
    def columns(self) -> int:
        """Cells along x."""
        return math.ceil(round(self.width_m / self.resolution, 6))

    @property
    def rows(self) -> int:
        """Cells along y."""
        return math.ceil(round(self.height_m / self.resolution, 6))

    @model_validator(mode="after")
    def _has_cells(self) -> Self:
        for name, cells in (("width_m", self.columns), ("height_m", self.rows)):
            if not 3 <= cells <= MAX_SIDE:
                raise ValueError(
                    f"{name}: is {cells} cells of {self.resolution:g} m; must be 3 to {MAX_SIDE}"
                )
        return self


OPTIONAL_TOPICS = ("scan", "map", "goal_pose", "navigate_to_pose")
TOPICS = (*OPTIONAL_TOPICS, "tf", "tf_static", "team_map", "status", "markers")
"""Settings that are names of topics, or of an action; the optional ones may be empty."""


class Ros2Table(Table):
    """Names and frames of the robot's ROS 2 nodes; names without a slash in front are relative to the namespace."""

    map_pose: tuple[Meters, Meters, Turn] = Field(
        description="pose of the robot's map frame in the common frame: x and y in meters, degrees counterclockwise"
    )
    router: str = Field("tcp/localhost:7447", description="address of the Zenoh router")
    domain: Whole = Field(0, ge=0, le=232, description="ROS_DOMAIN_ID")
    distro: Literal["humble", "jazzy", "kilted", "lyrical", "rolling"] = Field(
        "jazzy", description="distribution of the robot's nodes"
    )
    namespace: str = Field("", description="namespace of the robot, as r1; empty: none")
    node: str = Field("murmur", description="name of the node")
    scan: str = Field(
        "scan",
        description="laser scans (sensor_msgs/LaserScan); empty: the robot's own map takes their place",
    )
    tf: str = Field("tf", description="transforms; some robots have them at /tf")
    tf_static: str = Field("tf_static", description="static transforms")
    map: str = Field("map", description="the robot's own map, which limits goals; empty: it has none")
    goal_pose: str = Field("goal_pose", description="where goals are sent; empty: only to the action")
    navigate_to_pose: str = Field(
        "navigate_to_pose", description="action that is used instead while it has a server; empty: never"
    )
    team_map: str = Field("team_map", description="where the team's map is published")
    status: str = Field("murmur/status", description="where the status is published, as JSON")
    markers: str = Field("murmur/markers", description="where markers for RViz are published")
    map_frame: str = Field("map", description="the frame of the robot's map")
    base_frame: str = Field("base_link", description="the frame of the robot's base")

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if not self.scan and not self.map:
            raise ValueError(
                "scan and map are both empty, so that the robot has no readings; name one of them"
            )
        if not self.goal_pose and not self.navigate_to_pose:
            raise ValueError(
                "goal_pose and navigate_to_pose are both empty, so that the robot cannot be driven"
            )
        if not re.fullmatch(r"[a-z0-9-]+/\S+:[0-9]+([?#]\S+)?|unixsock-stream/\S+", self.router):
            raise ValueError(f"router = {self.router!r}: must be as tcp/localhost:7447")
        for name in ("map_frame", "base_frame"):
            if not (frame := getattr(self, name)) or frame.startswith("/"):
                raise ValueError(f"{name} = {frame!r}: must be the name of a frame, without a slash in front")
        check_node(self.node, self.namespace or "/")
        uses: dict[str, str] = {}
        for name in TOPICS:
            topic = getattr(self, name)
            if not topic and name in OPTIONAL_TOPICS:
                continue
            try:
                full = qualified(topic, self.namespace or "/", self.node)
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from None
            if full in uses:
                raise ValueError(
                    f"{name} = {topic!r}: is the topic of {uses[full]} as well; each needs its own"
                )
            uses[full] = name
        return self


@dataclass(frozen=True)
class RadioTable(LinkOptions):
    """The radio (`agent.radios.options`), and the team's key.

    `key`: the key file. `sessions`: the directory of the session file; by default that of the key.
    """

    key: str = Field("team.key", min_length=1)
    sessions: str = ""


class RecordTable(Table):
    """Where the robot writes its records."""

    folder: str = Field("record", min_length=1, description="directory of journal and records of this robot")


class TeammateTable(Table):
    """A teammate whose hardware differs from this robot's; plans use it, for example where it will see what."""

    robot: Whole = Field(ge=0, le=MAX_ROBOTS - 1, description="the teammate's number")
    sensor_range: float | None = Field(
        None,
        strict=True,
        gt=0,
        le=MAX_REACH_M,
        description="its `sensor_range`, meters; default: this robot's",
    )
    radius: NotNegative | None = Field(None, description="its radius, meters; default: this robot's")


class RobotSettings(ControlSettings):
    """All settings of one robot in the field; ScenarioError lists all keys and values that are wrong."""

    def __init__(self, **settings: Any) -> None:
        try:
            super().__init__(**settings)
        except ValidationError as error:
            raise explained(error, RobotSettings) from None

    robot: Whole = Field(ge=0, le=MAX_ROBOTS - 1, description="number of this robot, from 0")
    robots: Whole = Field(ge=1, le=MAX_ROBOTS, description="number of robots of the team")
    grid: GridTable = Field(description="the team's grid")
    ros2: Ros2Table = Field(description="the robot's ROS 2 nodes")
    radio: Annotated[RadioTable, exact(RadioTable)] = Field(description="the radio")
    record: RecordTable = Field(default_factory=RecordTable, description="records")
    teammate: tuple[TeammateTable, ...] = Field((), description="teammates with other hardware")
    seed: Whole = Field(0, ge=0, le=MAX_INTEGER, description="seed of all random draws")
    starts: Whole = Field(8, ge=1, le=256, description="how often each robot may start in this mission")
    sensor_range: float = Field(
        5.0, strict=True, gt=0, le=MAX_REACH_M, description="range up to which scans are mapped, meters"
    )
    speed: Positive = Field(0.5, description="largest speed of the robot, meters per second")
    radius: NotNegative = Field(0.2, description="radius of the robot, meters")
    step_s: float = Field(1.0, strict=True, ge=0.1, le=60.0, description="duration of a step, seconds")
    steps: Whole = Field(86400, ge=1, le=MAX_INTEGER, description="maximum number of steps")
    finish_s: Seconds = Field(
        30.0, description="the robot ends when it was done for so long: nothing to explore, and all delivered"
    )
    dead_man_s: Seconds = Field(
        3.0, description="the robot stands still if no scan with a pose has arrived for so long, seconds"
    )
    patience_s: Seconds = Field(20.0, description="a goal without progress for so long counts as unreachable")
    avoid_s: Seconds = Field(60.0, description="how long an unreachable goal is avoided, at first")
    absent_s: Seconds = Field(
        300.0, description="a teammate that has not been received for so long is not waited for at the end"
    )

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        from agent.encodings.catalog import encoding_class  # noqa: PLC0415  loads kernels, which --help does not need
        from agent.encodings.scans import ScanEncoding  # noqa: PLC0415
        from agent.strategies.registry import strategy  # noqa: PLC0415

        if not strategy(self.strategy).explores:
            raise ValueError(f"strategy = {self.strategy!r}: does not explore; choose another one")
        if not self.ros2.scan and issubclass(encoding_class(self.map_encoding), ScanEncoding):
            raise ValueError(
                f'ros2.scan = "": map_encoding = {self.map_encoding!r} sends laser scans; choose another encoding, '
                "or name the scans"
            )
        if self.robot >= self.robots:
            raise ValueError(
                f"robot = {self.robot}: the last robot of {self.robots} has number {self.robots - 1}"
            )
        numbers = [each.robot for each in self.teammate]
        check_numbers("teammate", numbers, self.robots)
        if self.robot in numbers:
            raise ValueError(
                f"[[teammate]] names robot {self.robot}, which is this robot: set its values at the top of the file"
            )
        if self.robots * self.starts > MAX_GOSSIP_MAPS:
            raise ValueError(
                f"starts = {self.starts}: packets can address {MAX_GOSSIP_MAPS} maps, one per start of each robot; "
                f"{self.robots} robots can start {MAX_GOSSIP_MAPS // self.robots} times each"
            )
        for reach in (self.sensor_range, *(each.sensor_range for each in self.teammate)):
            if reach is not None and reach < 2 * self.grid.resolution:
                raise ValueError(f"sensor_range = {reach:g}: must be two cells of the grid, or more")
        return self


@dataclass(frozen=True)
class RobotFile:
    """The settings of a robot, and the directory to which paths in them are relative."""

    settings: RobotSettings
    folder: Path

    @property
    def record(self) -> Path:
        """The directory of journal and records."""
        return self.folder / self.settings.record.folder

    @property
    def key(self) -> Path:
        """The team's key file."""
        return self.folder / self.settings.radio.key

    @property
    def sessions(self) -> Path:
        """The directory of the session file."""
        given = self.settings.radio.sessions
        return self.folder / given if given else self.key.parent

    def check_directories(self) -> None:
        """Raise ScenarioError if a directory of the robot's files cannot be created or written; nothing is created."""
        for name, folder in (("record.folder", self.record), ("radio.sessions", self.sessions)):
            existing = next(each for each in (folder, *folder.parents) if each.exists())
            if not existing.is_dir():
                raise ScenarioError(f"{name} = {folder}: {existing} is not a directory; name another")
            if not os.access(existing, os.W_OK | os.X_OK):
                raise ScenarioError(f"{name} = {folder}: nothing can be written in {existing}; name another")


def source(settings: RobotSettings) -> str:
    """Return what a robot's part of the team's map is made of, as text."""
    names = settings.ros2
    if names.scan:
        return f"laser scans on {names.scan!r}, with poses from {names.tf!r}"
    reach = f"{settings.sensor_range:g} m (sensor_range)"
    return f"its own map on {names.map!r}, up to {reach} around its poses from {names.tf!r}, as scan is empty"


def radio_text(settings: RobotSettings) -> str:
    """Return what a robot's radio may send, and when a teammate is out of range, as text."""
    radio = settings.radio
    if radio.medium == "udp":
        where = f"UDP on interface {radio.interface}, address {radio.address}, port {radio.udp_port}"
    else:
        where = f"modem at {radio.serial_port}, {radio.baud} baud"
    limits = f"{radio.rate:,} bytes per second, frames of at most {radio.longest:,} bytes"
    if radio.duty_cycle < 1:
        full = 3600 * radio.duty_cycle * SECOND / radio.airtime(radio.longest)
        limits += f", {100 * radio.duty_cycle:g} % of each hour (full frames: {full:.3g})"
    timeout = radio.timing().neighbor_timeout / SECOND
    return f"{where}; {limits}; teammates are out of range after {timeout:,.1f} s"


def load_robot(path: Path) -> RobotFile:
    """Read a robot's settings file; ScenarioError if it cannot be read, or a key or value is wrong."""
    path, data = read_toml(path, "robot")
    try:
        return RobotFile(RobotSettings(**data), path.parent)
    except ScenarioError as error:
        raise error.within(f"robot {path}") from None
