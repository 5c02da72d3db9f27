"""Messages of the bus: frozen records in msgpack.

A message is a msgpack list: its number, then its fields in order. The type of each field limits its range and length
(`protocol.message_fields`), so a receiver rejects all other bytes. `protocol.rights` has the senders and receivers of
each message.

Cells and grids are bytes (`protocol.cell_bytes`), and so are readings (`protocol.scans`). `protocol.message_codec`
writes and reads messages.
"""

from __future__ import annotations

from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from protocol import message_fields as fields
from protocol.budget import Budget

EVERYONE = -1
"""The receiver of a broadcast."""


class Record(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True, gc=False):
    """A message. The tag of its class is its number."""


class Begin(Record, tag=0, frozen=True):
    """Relay to world: all participants are present."""


class Configure(Record, tag=1, frozen=True):
    """Recorder to relay, and relay to that robot when it joins: the robot's encoded `agent.settings.Settings`."""

    robot: fields.RobotNumber
    settings: fields.EncodedSettings


class Sense(Record, tag=2, frozen=True):
    """World to robot, once per step: its position, the cells that it entered, its laser readings.

    `x`, `y`: cell. `heading`: eighths of a turn from +x towards +y. `driven`: cells entered since the last
    step. `readings`: one per beam (`protocol.scans`). `blocked`: why the last move stopped short. `offset_x`,
    `offset_y`: position within its cell, in thousandths of a cell from the center. `range_scan`: with a real laser,
    its scan (`protocol.range_scans`); `readings` is empty then, and the position is the believed one. `own_map`: of a
    robot that makes its map itself, the part that it knows (`protocol.own_map`), instead of a scan.
    """

    step: fields.Step
    x: fields.Coordinate
    y: fields.Coordinate
    heading: fields.Eighths
    driven: fields.WayCells
    readings: fields.Readings
    blocked: fields.Text
    offset_x: fields.Thousandths = 0
    offset_y: fields.Thousandths = 0
    range_scan: fields.Readings = b""
    own_map: fields.OwnMap = b""

    def __post_init__(self) -> None:
        if len(self.driven) % 4 or len(self.readings) % 2:
            raise ValueError(f"{len(self.driven)} and {len(self.readings)} bytes are not cells and readings")


class Move(Record, tag=3, frozen=True):
    """Robot to world: the cells to drive next, in order; the heading to take if it stays; whether it is done.

    `explored`: its planning grid has no reachable frontier, and the robot is at the end of its mission. `stalled`: it
    cannot make progress. `look`: whether it scans on the way. `points`: if not empty, way points to drive along
    instead of cells (`protocol.cell_bytes.points_to_bytes`).
    """

    step: fields.Step
    path: fields.WayCells
    heading: fields.Eighths
    explored: bool
    look: bool = True
    stalled: bool = False
    points: fields.WayPoints = b""

    def __post_init__(self) -> None:
        if len(self.path) % 4 or len(self.points) % 8:
            raise ValueError(
                f"{len(self.path)} and {len(self.points)} bytes are not pairs of int16 and of int32"
            )


class Positions(Record, tag=4, frozen=True):
    """World to relay, once per step: the true cells of robots."""

    step: fields.Step
    robots: fields.RobotNumbers
    x: fields.Coordinates
    y: fields.Coordinates

    def __post_init__(self) -> None:
        if not len(self.robots) == len(self.x) == len(self.y):
            raise ValueError("robots, x and y have different lengths")


class Part(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True, gc=False):
    """A struct within messages: a msgpack list of its fields in order."""


class OutgoingFrame(Part, frozen=True):
    """In `RobotFrames`: a frame that a robot sends.

    `receiver`: `EVERYONE` for a broadcast. `connection`: the connection that it answers, -1 for none.
    """

    receiver: fields.RobotOrNone
    payload: fields.Frame
    connection: fields.Connection = -1


class Delivery(Part, frozen=True):
    """In a relay event: a received frame.

    `connection`: -1 for none. `map_id`: the map of an offer, and of its answer; -1 for other frames.
    """

    sender: fields.RobotNumber
    payload: fields.Frame
    connection: fields.Connection = -1
    map_id: fields.RobotOrNone = -1


class ConnectionReport(Part, frozen=True):
    """In a `RoundReport`: the bytes of a connection's offer, answer and data that were on the air."""

    connection: fields.Connection
    offer: fields.Count = 0
    answer: fields.Count = 0
    data: fields.Count = 0


class SendReport(Part, frozen=True):
    """In a `RoundReport`: the bytes on the air of frame number `frame` of a `RobotFrames`."""

    frame: fields.FrameNumber
    sent: fields.Count


OutgoingFrames = Annotated[list[OutgoingFrame], Meta(max_length=fields.MAX_CONNECTIONS)]
Deliveries = Annotated[list[Delivery], Meta(max_length=fields.MAX_CONNECTIONS)]
ConnectionReports = Annotated[list[ConnectionReport], Meta(max_length=fields.MAX_CONNECTIONS)]
SendReports = Annotated[list[SendReport], Meta(max_length=fields.MAX_CONNECTIONS)]


class RobotFrames(Record, tag=7, frozen=True):
    """Robot to relay: all frames that it sends in a phase.

    `broadcast`: its pose and target for all in range, empty for none. `priority`: 0 to 255; the higher, the shorter its
    frames wait for a free medium.
    """

    step: fields.Step
    round: fields.Round
    phase: fields.Name
    broadcast: fields.Frame = b""
    frames: OutgoingFrames = []
    priority: fields.Priority = 0


class Open(Record, tag=5, frozen=True):
    """Event: a round begins; the robots `peers` are in range, and the robot may send `budget` bytes in it.

    The robot answers with the frames of the phase ``offers``, and in round 0 with its pose and target.
    """

    step: fields.Step
    round: fields.Round
    peers: fields.RobotNumbers
    budget: Budget


class Broadcasts(Record, tag=27, frozen=True):
    """Event: poses and targets arrived."""

    step: fields.Step
    deliveries: Deliveries


class PhaseDelivery(Record, tag=6, frozen=True):
    """Event: frames of a phase arrived, each of a connection.

    After ``offers`` the robot answers; after ``answers`` it sends data.
    """

    step: fields.Step
    round: fields.Round
    phase: fields.Name
    deliveries: Deliveries


class RoundReport(Record, tag=8, frozen=True):
    """Event: the end of a round; frames and bytes that it does not mention were not on the air.

    `connections`: those of this robot. `sent`: its frames, in rounds without connections. `deliveries`: data, or frames
    of any kind in rounds without connections. `broadcast_sent`: whether its pose and target were on the air.
    """

    step: fields.Step
    round: fields.Round
    connections: ConnectionReports
    sent: SendReports
    deliveries: Deliveries
    broadcast_sent: bool


class Close(Record, tag=9, frozen=True):
    """Event, and relay to world: the medium is closed for this step; merge, choose, plan, move."""

    step: fields.Step


MediumEvent = Open | Broadcasts | PhaseDelivery | RoundReport | Close
"""An event of the medium that concerns a robot."""


class RelayUpdate(Record, tag=25, frozen=True):
    """Relay to robot: events in the order in which they happened, each with its own deliveries."""

    events: Annotated[list[MediumEvent], Meta(max_length=fields.MAX_EVENTS)]


class Lost(Record, tag=10, frozen=True):
    """Relay to world and recorder: a robot is lost, with the known cause.

    World or recorder to relay: give the robot up, since it timed out or caused too many protocol errors.
    """

    robot: fields.RobotNumber
    cause: fields.Text


class End(Record, tag=11, frozen=True):
    """World to all: the run is over after `step`; `first` is the robot that finished first, or -1."""

    step: fields.StepOrNone
    reason: fields.Text
    first: fields.RobotOrNone


class FaultEvent(Record, tag=22, frozen=True, order=True):
    """A fault of one robot (`protocol.faults`). Recorder to relay: inject it; the relay forwards it to the world.

    World or relay to recorder: it has occurred. World to robot: end immediately.

    `step`: the fault occurs at the start of this step; from the recorder, 0 means the next step. `kind`: one of
    `protocol.faults.KINDS`. `steps`: duration of a temporary fault, 0 if permanent.
    """

    step: fields.Step
    robot: fields.RobotNumber
    kind: fields.Name
    steps: fields.Step = 0


class Change(Record, tag=24, frozen=True):
    """Another radio: recorder to relay, to request it; relay to recorder: it applies from this step on.

    `step`: the step at whose beginning it applies; from the recorder 0 means the next. `budget`: bytes per step;
    `range_mm`: the communication range in millimeters. None: unchanged.
    """

    step: fields.Step
    budget: Budget | None = None
    range_mm: fields.Count | None = None


class Back(Record, tag=23, frozen=True):
    """Relay to world and recorder: a lost robot has joined again."""

    robot: fields.RobotNumber


class Reconnected(Record, tag=29, frozen=True):
    """Relay to a robot, world and recorder: the robot's connection is restored; send your last messages again."""

    robot: fields.RobotNumber


class Stop(Record, tag=12, frozen=True):
    """Recorder to world, by way of the relay: end after this step, for `reason`."""

    reason: fields.Text


class Shutdown(Record, tag=13, frozen=True):
    """Recorder to all, by way of the relay: everything is recorded, shut down."""


class Watched(Record, tag=19, frozen=True):
    """Relay to all: a viewer has joined (or left); it gets the same reports as the recorder."""

    here: bool


class WorldReport(Record, tag=14, frozen=True):
    """World to recorder, once per step: ground truth.

    `poses`: int32 rows (robot, x in mm, y in mm, heading in tenths of a degree). `seen`: free cells that the team's
    lasers have observed. `reachable`: free cells that robots can reach. `driven`: mm that each robot drove. `people`:
    int32 rows (x in mm, y in mm) of the people in the building.
    """

    step: fields.Step
    poses: fields.Poses
    driven: fields.Distances
    seen: fields.CellCount
    reachable: fields.CellCount
    people: fields.People = b""

    def __post_init__(self) -> None:
        if len(self.poses) % 16 or len(self.people) % 8:
            reason = f"{len(self.poses)} and {len(self.people)} bytes are not rows of four and of two int32"
            raise ValueError(reason)

    @property
    def pose_rows(self) -> NDArray[np.int32]:
        """The rows of `poses`, shape (n, 4)."""
        return np.frombuffer(self.poses, "<i4").reshape(-1, 4)


class RobotStatus(Record, tag=15, frozen=True):
    """Robot to recorder, once per step: its target, its map, and its computing time (not a result).

    `error`: cells in which its map differs from the map that its log describes (Eq. 6.1). `exact_error`: the same for a
    lossless log, -1 if not measured. `backlog`: own log entries not delivered yet, summed over all teammates.
    """

    step: fields.Step
    target_x: fields.CoordinateOrNone
    target_y: fields.CoordinateOrNone
    known: fields.CellCount
    error: fields.CellCount
    exact_error: fields.CellCountOrNone
    backlog: fields.Count
    status: fields.Text
    work_us: fields.Count


class RadioReport(Record, tag=16, frozen=True):
    """Relay to recorder and viewer, once per step: new rows of the ledger (`netshaper.ledger`), and frames or links.

    `frames`: for the recorder, as the capture writes them (`netshaper.capture`). `links`: for the viewer, the bytes
    that robots received from each other (`netshaper.ledger.LINK`).
    """

    step: fields.Step
    rows: fields.Blocks
    carried: fields.Count
    frames: fields.Blocks
    links: fields.Blocks = b""


class RequestMaps(Record, tag=28, frozen=True):
    """Recorder to relay, and relay to that robot, at the end: send this part of your maps.

    `step`: the last step of the robot.
    """

    robot: fields.RobotNumber
    step: fields.Step
    part: fields.PartNumber


class MapPart(Record, tag=17, frozen=True):
    """Robot to recorder, on request: a part of its two maps (`protocol.map_parts`)."""

    part: fields.PartNumber
    cells: fields.PartBytes


class Snapshot(Record, tag=20, frozen=True):
    """Robot to viewer, at intervals: its planning grid (`protocol.cell_bytes.grid_to_bytes`)."""

    step: fields.Step
    width: fields.SideLength
    height: fields.SideLength
    planning: fields.Cells


class MapChanges(Record, tag=26, frozen=True):
    """Robot to recorder, every few steps: the cells of its two maps that changed since its last report.

    `cells`: uint32 indices into the map, row after row. `values`: one byte per cell, bits 0-1 the value on the robot's
    own map, bits 2-3 the value on its planning map.
    """

    step: fields.Step
    cells: fields.CellIndices
    values: fields.Cells

    def __post_init__(self) -> None:
        if len(self.cells) != 4 * len(self.values):
            raise ValueError(f"{len(self.values)} values for {len(self.cells)} bytes of cell indices")


class Outlines(Record, tag=21, frozen=True):
    """Robot to viewer and recorder, if they changed: the polygons of map `map_id`, as this robot holds them.

    `vertices`: int16 rows (object, x and y in quarters of a cell, bit 0 occupied edge, bit 1 inside object).
    """

    step: fields.Step
    map_id: fields.RobotNumber
    vertices: fields.Vertices

    def __post_init__(self) -> None:
        if len(self.vertices) % 8:
            raise ValueError(f"{len(self.vertices)} bytes of vertices are not rows of four int16")


class Missed(Record, tag=30, frozen=True):
    """World or relay to recorder and viewer: by the wall clock, robots missed a phase of a step (docs/clocks.md).

    `phase`: of the medium, with its `round`; from the world ``step`` if they took no part in the step, and ``move`` if
    their moves were late.
    """

    step: fields.Step
    phase: fields.Name
    round: fields.Round
    robots: fields.RobotNumbers


class ErrorReport(Record, tag=18, frozen=True):
    """Relay, world or robot to recorder: `participant` caused a protocol error; the run continues."""

    participant: fields.Name
    reason: fields.Text


TYPES: tuple[type[Record], ...] = tuple(
    sorted(Record.__subclasses__(), key=lambda kind: int(kind.__struct_config__.tag or 0))
)
"""All messages, by their number."""
