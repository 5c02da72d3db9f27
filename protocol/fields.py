"""What the fields of messages may be: kind, range and length of each, checked by whoever reads one (msgspec)."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from protocol.grid import MAX_ROBOTS, MAX_SIDE

MOST_STEPS = 2**31 - 1
MOST_CELLS = MAX_SIDE * MAX_SIDE
MOST_BEAMS = 3600
MOST_ON_THE_WAY = 1 << 16
"""Cells, or way points, of a move."""
MOST_CONNECTIONS = 1 << 13
"""Connections of one robot in a round: 63 teammates offer it 64 maps each, and it offers them as many."""
MOST_FRAME, MOST_FRAMES = 1 << 24, 1 << 28
"""Bytes of a frame, and of all frames of a list in a message."""
MOST_WORD, MOST_TEXT = 16, 1000
"""Characters."""

Step = Annotated[int, Meta(ge=0, le=MOST_STEPS)]
StepOrNone = Annotated[int, Meta(ge=-1, le=MOST_STEPS)]
Round = Annotated[int, Meta(ge=0, lt=16)]
RobotNumber = Annotated[int, Meta(ge=0, lt=MAX_ROBOTS)]
RobotOrNone = Annotated[int, Meta(ge=-1, lt=MAX_ROBOTS)]
Coordinate = Annotated[int, Meta(ge=0, lt=MAX_SIDE)]
CoordinateOrNone = Annotated[int, Meta(ge=-1, lt=MAX_SIDE)]
SideLength = Annotated[int, Meta(ge=1, le=MAX_SIDE)]
Eighths = Annotated[int, Meta(ge=0, lt=8)]
Thousandths = Annotated[int, Meta(ge=-1000, le=1000)]
CellCount = Annotated[int, Meta(ge=0, le=MOST_CELLS)]
CellCountOrNone = Annotated[int, Meta(ge=-1, le=MOST_CELLS)]
Count = Annotated[int, Meta(ge=0, lt=2**53)]
Connection = Annotated[int, Meta(ge=-1, lt=2**31)]
Priority = Annotated[int, Meta(ge=0, le=255)]

Word = Annotated[str, Meta(max_length=MOST_WORD)]
Text = Annotated[str, Meta(max_length=MOST_TEXT)]

RobotNumbers = Annotated[list[RobotNumber], Meta(max_length=MAX_ROBOTS)]
Coordinates = Annotated[list[Coordinate], Meta(max_length=MAX_ROBOTS)]
Distances = Annotated[list[Count], Meta(max_length=MAX_ROBOTS)]
FrameNumber = Annotated[int, Meta(ge=0, lt=MOST_CONNECTIONS)]
Frame = Annotated[bytes, Meta(max_length=MOST_FRAME)]
Frames = Annotated[list[Frame], Meta(max_length=MOST_CONNECTIONS)]

WayCells = Annotated[bytes, Meta(max_length=4 * MOST_ON_THE_WAY)]
WayPoints = Annotated[bytes, Meta(max_length=8 * MOST_ON_THE_WAY)]
Readings = Annotated[bytes, Meta(max_length=2 * MOST_BEAMS)]
EncodedSettings = Annotated[bytes, Meta(max_length=1 << 20)]
Poses = Annotated[bytes, Meta(max_length=16 * MAX_ROBOTS)]
Cells = Annotated[bytes, Meta(max_length=MOST_CELLS)]
CellIndices = Annotated[bytes, Meta(max_length=4 * MOST_CELLS)]
Vertices = Annotated[bytes, Meta(max_length=1 << 24)]
Books = Annotated[bytes, Meta(max_length=1 << 30)]


def clip(text: str) -> str:
    """A text as long as a field may be."""
    return text if len(text) <= MOST_TEXT else text[: MOST_TEXT - 1] + "…"
