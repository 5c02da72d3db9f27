"""The settings that a robot receives before its first step (`protocol.messages.Configure`)."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from protocol.budget import Budget
from protocol.errors import ProtocolError
from protocol.range_scans import Laser


class Settings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The task of one robot."""

    robot: int
    robots: int
    """The number of this robot, and the size of the team."""
    width: int
    height: int
    """Size of the grid in cells."""
    ranges_cells: list[float]
    """Sensor range of each robot, in cells."""
    beams: int
    """Laser beams per full turn."""
    speed_cells: float
    """Distance that the robot can drive in a step, in cells."""
    seed: int
    """Seed of the run."""
    map_encoding: str
    """Name of the map encoding (`agent.encodings`)."""
    strategy: str
    """Name of the exploration strategy (`agent.strategies`)."""
    dissemination: str
    """Dissemination policy of the maps: ``backoff``, ``thesis`` or ``gossip`` (`agent.replication.policies`)."""
    bandwidth: Budget
    """Bytes per step that the team shares."""
    reach_cells: float
    """Communication range in cells."""
    polygons: dict[str, Any] = {}
    """Options of the `polygons` encoding by name (`agent.encodings.options`)."""
    predictive: dict[str, Any] = {}
    """Options of the `predictive` encoding by name (`agent.encodings.options`)."""
    options: dict[str, Any] = {}
    """Options of the strategy by name."""
    resolution: float = 0.1
    """Side of a cell in meters."""
    radii_cells: list[float] = []
    """Radius of each robot in cells, 0 for a point; empty: all robots are points."""
    field_of_view: float = 360.0
    """Angle that the laser covers around the robot's heading, in degrees."""
    scanner_turn: float = 0.0
    """Angle that the scanner turns and covers per step, in degrees; 0: it covers everything in each step."""
    forward_maps: bool = True
    """Whether the robot sends maps of other robots as well as its own."""
    requires_acks: bool = False
    """Whether only a peer's acknowledgment shows a delivery: the medium may lose frames, or peers may be deaf."""
    frame_bytes: int | None = None
    """Largest size of a packet in bytes; None: that of the longest packet."""
    incarnations: int = 1
    """Largest number of incarnations of a robot: one, and one more for each restart (`agent.identity`)."""
    incarnation: int = 0
    """Number of this incarnation, from 0."""
    home: tuple[int, int] | None = None
    """Start cell of the first incarnation; None: the start cell of this one."""
    fastest_cells: float = 0.0
    """Distance that the fastest robot of the team can drive in a step, in cells."""
    digests: bool = False
    """Whether the robot broadcasts digests of its log (`agent.replication.digests`)."""
    record_maps: bool = False
    """Whether to report map changes to the recorder."""
    laser: Laser | None = None
    """The beams of the robots' lasers; None: exact readings in cells (`protocol.scans`)."""
    people: bool = False
    """Whether people walk about in the building: what lasers see as a wall may be a person."""
    tolerance: int = 0
    """Cells between a wall and its copy on a teammate's map at most; 0: copies are exact."""

    @property
    def maps(self) -> int:
        """Largest number of maps: one per incarnation of each robot."""
        return self.robots * self.incarnations

    @property
    def own_map(self) -> int:
        """The map ID of this robot and incarnation (`agent.identity`)."""
        return self.robot + self.robots * self.incarnation

    @property
    def shares_tiles(self) -> bool:
        """Whether the `predictive` encoding sends tiles of grids instead of exact scans."""
        return self.laser is not None or self.tolerance > 0

    def author_of(self, map_id: int) -> int:
        """Return the robot whose map has this ID, in any of its incarnations."""
        return map_id % self.robots

    @property
    def range_cells(self) -> float:
        """This robot's sensor range, in cells."""
        return self.ranges_cells[self.robot]

    @property
    def scale_cells(self) -> float:
        """The longest sensor range of the team in cells: the common unit of distances in strategies."""
        return max(self.ranges_cells)

    def ranges_of(self, robots: Iterable[int]) -> NDArray[np.float64]:
        """Return the sensor range of each of `robots`, in cells: float64 array, shape (n,)."""
        return np.array([self.ranges_cells[robot] for robot in robots], np.float64)

    @property
    def radius_cells(self) -> float:
        """This robot's radius, in cells."""
        return self.radius_of(self.robot)

    def radius_of(self, robot: int) -> float:
        """Return a robot's radius, in cells."""
        return self.radii_cells[robot] if self.radii_cells else 0.0

    @property
    def turn_steps(self) -> int:
        """Steps of a full turn of the scanner."""
        return math.ceil(360 / self.scanner_turn) if self.scanner_turn else 1

    def encode(self) -> bytes:
        """Return these settings in msgpack, for `decode`."""
        return _encode(self)

    @classmethod
    def decode(cls, data: bytes) -> Settings:
        """Read encoded settings; ProtocolError if a setting is missing, unknown or of the wrong type."""
        try:
            return _decode(data)
        except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
            raise ProtocolError("Configure", 0, f"not a robot's settings: {error}") from None


_encode = msgspec.msgpack.Encoder().encode
_decode = msgspec.msgpack.Decoder(Settings).decode
