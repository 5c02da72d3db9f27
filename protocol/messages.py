"""What is said on the body and control planes: frozen records in msgpack.

A message is a msgpack list: its number, then its fields in order. Cells go as little-endian
int16 pairs (`cells_to_bytes`), readings as little-endian uint16 (`protocol.scans`), grids at two bits a cell.
"""

from __future__ import annotations

from typing import Any, TypeVar, Union

import msgspec
import numpy as np
from numpy.typing import NDArray

from protocol.errors import ProtocolError
from protocol.grid import Grid


class Record(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True, gc=False):
    """What all messages are: fields that do not change once they are said. The class' tag is its number."""


class Begin(Record, tag=0, frozen=True):
    """Relay to world: everyone is here."""


class Configure(Record, tag=1, frozen=True):
    """World to robot, before its first `Sense`: all that a robot is told of its task (`agent.settings`)."""

    settings: dict[str, Any]


class Sense(Record, tag=2, frozen=True):
    """World to robot, once a step: where it is, what it drove over, what its laser reads.

    `x`, `y`: cell. `heading`: eighths of a turn from +x towards +y. `driven`: cells entered since the last
    step. `readings`: one a beam (`protocol.scans`). `blocked`: why the last move stopped short. `offset_x`,
    `offset_y`: where in its cell it is, in thousandths of a cell from the centre.
    """

    step: int
    x: int
    y: int
    heading: int
    driven: bytes
    readings: bytes
    blocked: str
    offset_x: int = 0
    offset_y: int = 0


class Move(Record, tag=3, frozen=True):
    """Robot to world: the cells to drive next, in order; the heading to take if it stays; whether it is done.

    `explored` says that no reachable frontier is left on its planning grid, and that it is where its mission
    ends; `stalled`, that it sees no way on. `look`: whether its scanner works on the way. `points`, where
    there are any, are way points to drive along instead of cells (`points_to_bytes`).
    """

    step: int
    path: bytes
    heading: int
    explored: bool
    look: bool = True
    stalled: bool = False
    points: bytes = b""


class Positions(Record, tag=4, frozen=True):
    """World to relay, once a step: the cells in which the robots really are."""

    step: int
    robots: list[int]
    x: list[int]
    y: list[int]


class Open(Record, tag=5, frozen=True):
    """Relay to robot: the medium is open for exchange `exchange`; these teammates are in range.

    `budget` is what is left of this step's bytes, -1 for no limit. The robot says its target (in exchange
    0) and its offers.
    """

    step: int
    exchange: int
    peers: list[int]
    budget: int


class Turn(Record, tag=6, frozen=True):
    """Relay to robot: all frames of a phase have been passed on.

    `connections` and `maps` say what each is about, in the order in which they were passed on.
    After ``offers`` the robot answers; after ``answers`` it sends data.
    """

    step: int
    exchange: int
    phase: str
    connections: list[int]
    maps: list[int]


class Said(Record, tag=7, frozen=True):
    """Robot to relay: it has put all its frames of a phase.

    `connections` names them, in that order; it is empty for offers, which the relay has not numbered yet.
    `urgency`: how soon the news that it broadcasts should be on the air, 0 to 255; the more, the shorter it would
    wait for a free medium.
    """

    step: int
    exchange: int
    phase: str
    connections: list[int]
    urgency: int = 0


class Outcome(Record, tag=8, frozen=True):
    """Relay to robot, after the data: what was put on the air; the rest did not happen.

    `connections`, `offers`, `answers`, `data` are parallel: the bytes of each frame that were carried.
    `heard` names the connections whose data frames were passed on to this robot, in that order.
    `broadcast` tells whether its own was carried. News that are broadcast are of connection -1.
    """

    step: int
    exchange: int
    connections: list[int]
    offers: list[int]
    answers: list[int]
    data: list[int]
    heard: list[int]
    broadcast: bool


class Close(Record, tag=9, frozen=True):
    """Relay to robot: the medium is closed for this step; merge, choose, plan, move."""

    step: int


class Lost(Record, tag=10, frozen=True):
    """Relay to world and laboratory: a robot is gone, with what is known of the cause."""

    robot: int
    cause: str


class End(Record, tag=11, frozen=True):
    """World to all: the run is over after `step`; `first` is the robot that was done first, or -1."""

    step: int
    reason: str
    first: int


class Stop(Record, tag=12, frozen=True):
    """Laboratory to world, by way of the relay: end after this step, for `reason`."""

    reason: str


class Bye(Record, tag=13, frozen=True):
    """Laboratory to all, by way of the relay: everything is recorded, go home."""


class Watched(Record, tag=19, frozen=True):
    """Relay to all: a viewer has come (or gone); what is reported to the laboratory goes to it as well."""

    here: bool


class WorldReport(Record, tag=14, frozen=True):
    """World to laboratory, once a step: the truth.

    `poses`: int32 rows (robot, x in mm, y in mm, heading in tenths of a degree). `seen`: free cells that the
    team's lasers have truly seen; `reachable`: all that can be reached. `driven`: mm that each robot drove.
    """

    step: int
    poses: bytes
    driven: list[int]
    seen: int
    reachable: int


class MindReport(Record, tag=15, frozen=True):
    """Robot to laboratory, once a step: what it is at, and the time that its thinking took (not a result).

    `error`: cells in which its map and what it has told of it differ (Eq. 6.1); `exact_error`: what that would be if
    it had told all exactly, -1 if that is not measured. `backlog`: units of its own map's log that have not reached a
    teammate yet, all teammates counted.
    """

    step: int
    target_x: int
    target_y: int
    known: int
    error: int
    exact_error: int
    backlog: int
    status: str
    work_us: int


class RadioReport(Record, tag=16, frozen=True):
    """Relay to laboratory, once a step: the ledger's new rows (`netshaper.ledger`), and the frames themselves.

    `frames`: as the capture writes them (`netshaper.capture`).
    """

    step: int
    rows: bytes
    carried: int
    frames: bytes


class Maps(Record, tag=17, frozen=True):
    """Robot to laboratory, at the end: its two grids, row after row."""

    robot: int
    width: int
    height: int
    own: bytes
    planning: bytes


class Snapshot(Record, tag=20, frozen=True):
    """Robot to viewer, now and then: its planning grid (`grid_to_bytes`)."""

    step: int
    width: int
    height: int
    planning: bytes


class Outlines(Record, tag=21, frozen=True):
    """Robot to viewer, where they have changed: the polygons of robot `about`'s map, as this robot holds them.

    `vertices`: int16 rows (object, x and y in quarters of a cell, bit 0 occupied edge, bit 1 inside object).
    """

    step: int
    about: int
    vertices: bytes


class Fault(Record, tag=18, frozen=True):
    """Relay or robot to laboratory: `who` said what made no sense; the run goes on."""

    who: str
    what: str


_TYPES: tuple[type[Record], ...] = (
    Begin, Configure, Sense, Move, Positions, Open, Turn, Said, Outcome, Close, Lost, End, Stop, Bye,
    WorldReport, MindReport, RadioReport, Maps, Fault, Watched, Snapshot, Outlines,
)  # fmt: skip
_FIELDS = {kind: list(kind.__annotations__.items()) for kind in _TYPES}
_CHECK: dict[str, Any] = {
    "int": lambda value: type(value) is int,
    "bool": lambda value: type(value) is bool,
    "str": lambda value: type(value) is str,
    "bytes": lambda value: type(value) is bytes,
    "list[int]": lambda value: type(value) is list and {*map(type, value)} <= {int},
    "dict[str, Any]": lambda value: type(value) is dict,
}
_HEAD = {kind: 0x90 | len(wanted) + 1 for kind, wanted in _FIELDS.items()}
"""The first byte of each message: a list of so many items."""

_write = msgspec.msgpack.Encoder().encode
_read: Any = msgspec.msgpack.Decoder(Union[_TYPES]).decode  # noqa: UP007  a union of a tuple

Kind = TypeVar("Kind", bound=Record)


def pack(message: Record) -> bytes:
    """Write a message."""
    return _write(message)


def unpack(payload: bytes) -> Any:
    """Read a message.

    Raises
    ------
    ProtocolError
        It is not a message, or a field is missing or of the wrong type.
    """
    try:
        message = _read(payload)
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError):
        return _read_field_by_field(payload)
    # Fields that have a default must be there as well.
    return message if payload[0] == _HEAD[type(message)] else _read_field_by_field(payload)


def _read_field_by_field(payload: bytes) -> Any:
    """Read a message slowly, and say what is wrong with it."""
    try:
        items = msgspec.msgpack.decode(payload)
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
        raise ProtocolError("message", 0, f"not msgpack ({error})") from None
    if (
        not isinstance(items, list)
        or not items
        or type(items[0]) is not int
        or not 0 <= items[0] < len(_TYPES)
    ):
        raise ProtocolError("message", 0, "not a list that begins with the number of a message")
    kind = _TYPES[items[0]]
    wanted = _FIELDS[kind]
    if len(items) != len(wanted) + 1:
        raise ProtocolError(kind.__name__, 0, f"{len(items) - 1} fields instead of {len(wanted)}")
    for (name, annotation), value in zip(wanted, items[1:], strict=True):
        if not _CHECK[annotation](value):
            raise ProtocolError(kind.__name__, 0, f"{name} must be {annotation}, not {value!r:.40}")
    return kind(*items[1:])


def unpack_as(kind: type[Kind], payload: bytes) -> Kind:
    """Read a message that must be of one kind; ProtocolError otherwise."""
    message = unpack(payload)
    if not isinstance(message, kind):
        raise ProtocolError(type(message).__name__, 0, f"expected {kind.__name__} here")
    return message


def cells_to_bytes(cells: NDArray[np.int32]) -> bytes:
    """Write cells, shape (n, 2), as little-endian int16 pairs x, y."""
    return cells.astype("<i2").tobytes()


def cells_from_bytes(data: bytes) -> NDArray[np.int32]:
    """Read what `cells_to_bytes` wrote; ProtocolError if it cannot be pairs."""
    if len(data) % 4:
        raise ProtocolError("cells", 0, f"{len(data)} bytes are not pairs of int16")
    return np.frombuffer(data, "<i2").astype(np.int32).reshape(-1, 2)


def grid_to_bytes(grid: Grid) -> bytes:
    """Write a grid, two bits a cell, the first in the highest; each row filled up to a whole byte."""
    padded = np.zeros((grid.shape[0], -(-grid.shape[1] // 4) * 4), np.uint8)
    padded[:, : grid.shape[1]] = grid
    return (padded[:, ::4] << 6 | padded[:, 1::4] << 4 | padded[:, 2::4] << 2 | padded[:, 3::4]).tobytes()


def grid_from_bytes(data: bytes, width: int, height: int) -> Grid:
    """Read what `grid_to_bytes` wrote; ProtocolError if it is not a grid of that size."""
    row = -(-width // 4)
    if width < 1 or height < 1 or len(data) != row * height:
        raise ProtocolError("grid", 0, f"{len(data)} bytes are not {width} x {height} cells")
    packed = np.frombuffer(data, np.uint8).reshape(height, row)
    grid = np.stack([packed >> 6, packed >> 4 & 3, packed >> 2 & 3, packed & 3], axis=2)
    return np.ascontiguousarray(grid.reshape(height, -1)[:, :width])


def points_to_bytes(points: NDArray[np.int32]) -> bytes:
    """Write way points, shape (n, 2), in thousandths of a cell, as little-endian int32 pairs x, y."""
    return points.astype("<i4").tobytes()


def points_from_bytes(data: bytes) -> NDArray[np.int32]:
    """Read what `points_to_bytes` wrote; ProtocolError if it cannot be pairs."""
    if len(data) % 8:
        raise ProtocolError("points", 0, f"{len(data)} bytes are not pairs of int32")
    return np.frombuffer(data, "<i4").astype(np.int32).reshape(-1, 2)
