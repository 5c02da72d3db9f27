"""Types of the fields of messages (`protocol.messages`), with the limits of their values."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from protocol.grid import FINE, MAX_ROBOTS, MAX_SIDE

MAX_STEPS = 2**31 - 1
MAX_CELLS = MAX_SIDE * MAX_SIDE
MAX_BEAMS = 3600
MAX_WAY_CELLS = 1 << 16
"""Maximum number of cells, or way points, of a move."""
MAX_CONNECTIONS = 1 << 13
"""Connections of one robot in a round: each of 63 teammates offers it 64 maps, and it offers each of them 64."""
MAX_FRAME, MAX_FRAMES = 1 << 24, 1 << 28
"""Maximum bytes of a frame, and of all frames of a list in a message."""
MAX_PAYLOAD, MAX_ROBOT_PAYLOAD = 1 << 31, 24 << 20
"""Maximum bytes of a message, and of a message of a robot."""
MAX_LOAD = 1 << 23
"""Maximum bytes of log entries that a robot sends in a phase, also without a budget."""
PART_CELLS = 1 << 19
"""Maximum number of cells of a part of a robot's maps (`protocol.map_parts`)."""
MAX_EVENTS = 8
"""Maximum number of events in one `RelayUpdate`."""
MAX_PEOPLE = 100
"""Maximum number of people in the world."""
MAX_NAME, MAX_TEXT = 16, 1000
"""Maximum length in characters."""

Step = Annotated[int, Meta(ge=0, le=MAX_STEPS)]
StepOrNone = Annotated[int, Meta(ge=-1, le=MAX_STEPS)]
Round = Annotated[int, Meta(ge=0, lt=16)]
RobotNumber = Annotated[int, Meta(ge=0, lt=MAX_ROBOTS)]
RobotOrNone = Annotated[int, Meta(ge=-1, lt=MAX_ROBOTS)]
Coordinate = Annotated[int, Meta(ge=0, lt=MAX_SIDE)]
CoordinateOrNone = Annotated[int, Meta(ge=-1, lt=MAX_SIDE)]
SideLength = Annotated[int, Meta(ge=1, le=MAX_SIDE)]
Eighths = Annotated[int, Meta(ge=0, lt=8)]
Thousandths = Annotated[int, Meta(ge=-FINE, le=FINE)]
CellCount = Annotated[int, Meta(ge=0, le=MAX_CELLS)]
CellCountOrNone = Annotated[int, Meta(ge=-1, le=MAX_CELLS)]
Count = Annotated[int, Meta(ge=0, lt=2**53)]
Connection = Annotated[int, Meta(ge=-1, lt=2**31)]
Priority = Annotated[int, Meta(ge=0, le=255)]

Name = Annotated[str, Meta(max_length=MAX_NAME)]
Text = Annotated[str, Meta(max_length=MAX_TEXT)]

RobotNumbers = Annotated[list[RobotNumber], Meta(max_length=MAX_ROBOTS)]
Coordinates = Annotated[list[Coordinate], Meta(max_length=MAX_ROBOTS)]
Distances = Annotated[list[Count], Meta(max_length=MAX_ROBOTS)]
FrameNumber = Annotated[int, Meta(ge=0, lt=MAX_CONNECTIONS)]
Frame = Annotated[bytes, Meta(max_length=MAX_FRAME)]

WayCells = Annotated[bytes, Meta(max_length=4 * MAX_WAY_CELLS)]
WayPoints = Annotated[bytes, Meta(max_length=8 * MAX_WAY_CELLS)]
Readings = Annotated[bytes, Meta(max_length=2 * MAX_BEAMS + 10)]
OwnMap = Annotated[bytes, Meta(max_length=MAX_CELLS + 16)]
EncodedSettings = Annotated[bytes, Meta(max_length=1 << 20)]
Poses = Annotated[bytes, Meta(max_length=16 * MAX_ROBOTS)]
People = Annotated[bytes, Meta(max_length=8 * MAX_PEOPLE)]
Cells = Annotated[bytes, Meta(max_length=MAX_CELLS)]
PartNumber = Annotated[int, Meta(ge=0, lt=-(-MAX_CELLS // PART_CELLS))]
PartBytes = Annotated[bytes, Meta(max_length=PART_CELLS + (PART_CELLS >> 8))]
CellIndices = Annotated[bytes, Meta(max_length=4 * MAX_CELLS)]
Vertices = Annotated[bytes, Meta(max_length=1 << 21)]
Blocks = Annotated[bytes, Meta(max_length=1 << 30)]


def clip(text: str) -> str:
    """Cut a text to the maximum length of a field."""
    return text if len(text) <= MAX_TEXT else text[: MAX_TEXT - 1] + "…"
