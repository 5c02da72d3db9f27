"""The settings that a robot receives before its first step (`protocol.messages.Configure`)."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import cached_property
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from agent.encoding_options import PolygonOptions, PredictiveOptions
from protocol.body import Body
from protocol.budget import UNLIMITED, Budget
from protocol.errors import ProtocolError
from protocol.grid import Cell
from protocol.message_fields import SideLength
from protocol.range_scans import Laser


class EncodingSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How maps are encoded."""

    name: str
    """Name of the map encoding (`agent.encodings`)."""
    polygons: PolygonOptions = PolygonOptions()
    predictive: PredictiveOptions = PredictiveOptions()
    tolerance: int = 0
    """Cells between a wall and its copy on a teammate's map at most; 0: copies are exact."""


class ReplicationSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How map logs reach all robots."""

    dissemination: str
    """Name of the dissemination of the maps (`agent.replication.engine`)."""
    forward_maps: bool = True
    """Whether the robot sends maps of other robots as well as its own."""
    requires_acks: bool = False
    """Whether only a peer's acknowledgment shows a delivery: the medium may lose frames, or peers may be deaf."""
    round_trip: int = 0
    """The most steps for which a frame and the answer to it are under way, besides the step of sending."""
    digests: bool = False
    """Whether the robot broadcasts digests of its log (`agent.replication.digests`)."""
    checks_reach: bool = True
    """Whether it rejects entries that their author cannot have observed; all robots must count the same steps, and
    know each other's bodies (`agent.encodings.reachability_check`)."""


class MediumSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Limits of the medium that the robots share."""

    bandwidth: Budget = UNLIMITED
    """Bytes per step that the team shares."""
    reach_cells: float = math.inf
    """Communication range in cells."""
    frame_bytes: int | None = None
    """Largest size of a packet in bytes; None: that of the longest packet."""


class Settings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, dict=True):
    """The task of one robot."""

    robot: int
    """The number of this robot."""
    bodies: tuple[Body, ...]
    """The hardware of each robot of the team."""
    width: SideLength
    height: SideLength
    """Size of the grid in cells."""
    beams: int
    """Laser beams per full turn."""
    seed: int
    """Seed of the run."""
    strategy: str
    """Name of the exploration strategy (`agent.strategies`)."""
    encoding: EncodingSettings
    replication: ReplicationSettings
    medium: MediumSettings = MediumSettings()
    options: dict[str, Any] = {}
    """Options of the strategy by name."""
    resolution: float = 0.1
    """Side of a cell in meters."""
    min_frontier_cells: float = 0.0
    """Size in cells below which frontiers are not explored (`agent.planning.small_frontiers`)."""
    has_own_map: bool = False
    """Whether the robot makes its map by itself (`protocol.messages.Sense.own_map`); its laser then only bounds it."""
    people: bool = False
    """Whether people walk about in the building: a wall in a scan may be a person."""
    incarnations: int = 1
    """Largest number of incarnations of a robot: one, and one more for each restart (`agent.identity`)."""
    incarnation: int = 0
    """Number of this incarnation, from 0."""
    home: Cell | None = None
    """Start cell of the first incarnation; None: the start cell of this one."""
    record_maps: bool = False
    """Whether to report map changes to the recorder."""

    def __post_init__(self) -> None:
        if not 0 <= self.robot < len(self.bodies):
            raise ValueError(f"robot = {self.robot}: the team has {len(self.bodies)} robots, from 0")
        if len({body.laser is None for body in self.bodies}) > 1:
            raise ValueError("bodies: all robots, or none, must have a laser that measures ranges in meters")

    @property
    def robots(self) -> int:
        """Size of the team."""
        return len(self.bodies)

    @property
    def body(self) -> Body:
        """This robot's hardware."""
        return self.bodies[self.robot]

    @property
    def laser(self) -> Laser | None:
        """The beams of this robot's laser; None: all robots have exact readings in cells (`protocol.scans`)."""
        return self.body.laser

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
        return self.laser is not None or self.encoding.tolerance > 0

    def author_of(self, map_id: int) -> int:
        """Return the robot whose map has this ID, in any of its incarnations."""
        return map_id % self.robots

    @cached_property
    def scale_cells(self) -> float:
        """The longest sensor range of the team in cells: the common unit of distances in strategies."""
        return max(body.range_cells for body in self.bodies)

    def ranges_of(self, robots: Iterable[int]) -> NDArray[np.float64]:
        """Return the sensor range of each of `robots`, in cells: float64 array, shape (n,)."""
        return np.array([self.bodies[robot].range_cells for robot in robots], np.float64)

    def encode(self) -> bytes:
        """Return these settings in msgpack, for `decode`."""
        return _encode(self)

    @classmethod
    def decode(cls, data: bytes) -> Settings:
        """Read encoded settings; ProtocolError if a setting is missing, unknown or of the wrong type.

        Unknown options of encodings are ignored.
        """
        try:
            return _decode(data)
        except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
            raise ProtocolError("Configure", 0, f"not a robot's settings: {error}") from None


_encode = msgspec.msgpack.Encoder().encode
_decode = msgspec.msgpack.Decoder(Settings).decode
