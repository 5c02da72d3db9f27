"""The settings that a robot receives before its first step (`protocol.messages.Configure`)."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from protocol.errors import ProtocolError


class Settings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One robot's task.

    Attributes
    ----------
    robot, robots : int
        Its number, and how many there are.
    width, height : int
        Size of the grid in cells.
    ranges_cells : list of float
        Sensor range of every robot, in cells.
    beams : int
        Laser beams a full turn.
    speed_cells : float
        Cells that the robot can drive in a step.
    seed : int
        The run's seed.
    map_encoding : str
        How maps are encoded (`agent.encodings`).
    strategy : str
        Which target comes next (`agent.strategies`).
    resolution : float
        Side of a cell in metres.
    radii_cells : list of float
        Radius of every robot, in cells; 0 for a point. Empty: all are points.
    field_of_view : float
        Degrees that its laser covers, around its heading.
    scanner_turn : float
        Degrees that the scanner turns and covers per step; 0 if it covers everything at once.
    dissemination : str
        Which map log entries are sent to which teammates: ``backoff``, ``thesis`` or ``gossip``
        (`agent.replication.policies`).
    bandwidth : float or None
        Bytes a step that the team shares; None: unlimited.
    reach_cells : float
        Communication range in cells.
    polygons : dict
        Options of the polygon exchange, by name (`agent.encodings.polygons`).
    predictive : dict
        Options of the predictive exchange, by name (`agent.encodings.predictive`).
    options : dict
        Options of the strategy, by name.
    pass_on : bool
        Whether it offers maps of others as well as its own.
    confirms : bool
        Whether only what a teammate says tells that something has reached it, for the medium may lose it, or the
        teammate go deaf to what is broadcast.
    frame_bytes : int or None
        Bytes that a packet may have; None: those of the longest.
    lives : int
        How often a robot may begin: once, and once more for each time that it may come back (`agent.identity`).
    life : int
        Which of its lives this is, from 0.
    home : (x, y) or None
        Cell where its first life began; None: here and now.
    fastest_cells : float
        Cells that the fastest robot of the team can drive in a step.
    record_maps : bool
        Whether to report changes of its maps to the recorder.
    """

    robot: int
    robots: int
    width: int
    height: int
    ranges_cells: list[float]
    beams: int
    speed_cells: float
    seed: int
    map_encoding: str
    strategy: str
    dissemination: str
    bandwidth: float | None
    reach_cells: float
    polygons: dict[str, Any] = {}
    predictive: dict[str, Any] = {}
    options: dict[str, Any] = {}
    resolution: float = 0.1
    radii_cells: list[float] = []
    field_of_view: float = 360.0
    scanner_turn: float = 0.0
    forward_maps: bool = True
    requires_acks: bool = False
    frame_bytes: int | None = None
    incarnations: int = 1
    incarnation: int = 0
    home: tuple[int, int] | None = None
    fastest_cells: float = 0.0
    record_maps: bool = False

    @property
    def maps(self) -> int:
        """How many maps there may be: one a life of each robot."""
        return self.robots * self.incarnations

    @property
    def own_map(self) -> int:
        """The number of the robot's own map: it says whose, and of which life (`agent.identity`)."""
        return self.robot + self.robots * self.incarnation

    @property
    def range_cells(self) -> float:
        """The robot's own sensor range, in cells."""
        return self.ranges_cells[self.robot]

    @property
    def scale_cells(self) -> float:
        """The sensor range in which the team counts ways and sizes, in cells: the longest, the same to all members."""
        return max(self.ranges_cells)

    def ranges_of(self, robots: Iterable[int]) -> NDArray[np.float64]:
        """Sensor range of each of `robots`, in cells."""
        return np.array([self.ranges_cells[robot] for robot in robots], np.float64)

    @property
    def radius_cells(self) -> float:
        """The robot's own radius, in cells."""
        return self.radius_of(self.robot)

    def radius_of(self, robot: int) -> float:
        """A robot's radius, in cells."""
        return self.radii_cells[robot] if self.radii_cells else 0.0

    @property
    def turn_steps(self) -> int:
        """Steps in which the scanner makes a full turn."""
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
