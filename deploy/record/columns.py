"""The columns of a run's tables, with types, units and meanings: the tables are made by it, and docs from it."""

from __future__ import annotations

from typing import Any, NamedTuple


class Column(NamedTuple):
    """A column of a parquet file: arrow's name of its type, and what is in it."""

    name: str
    type: str
    meaning: str


STEPS = (
    Column("step", "int32", "the step, from 1; one is one second"),
    Column("robot", "int32", "the robot's number, from 0; a robot that is dead or lost has no row"),
    Column("x", "double", "metres to the right, in the map's frame"),
    Column("y", "double", "metres upwards, in the map's frame"),
    Column("heading", "double", "degrees; 0 looks along x, 90 along -y"),
    Column("driven", "double", "metres driven since the start"),
    Column("team_seen", "double", "share of what can be reached that the team has seen, 0 to 1"),
    Column("target_x", "double", "metres, as x, of the cell that it is headed for; null: it has no target"),
    Column("target_y", "double", "metres, as y"),
    Column("known_cells", "int32", "cells of its own map that are known"),
    Column("backlog", "int32", "packets of its logs that a teammate lacks, summed over teammates"),
    Column("status", "string", "what it says that it does"),
    Column("work_us", "int32", "microseconds that its process has worked in this step"),
)
"""One row per step and robot (``steps.parquet``)."""

LEDGER = (
    Column("step", "int32", "the step, from 1"),
    Column("round", "int16", "the round within the step, from 0"),
    Column("connection", "int32", "within the step, in the order of processing; -1: none"),
    Column("frame", "int16", "0 offer, 1 answer, 2 data, 3 broadcast, 4 news"),
    Column("sender", "int16", "the robot that sent it"),
    Column("receiver", "int16", "the robot that it was for; -1: broadcast"),
    Column("map", "int16", "whose map the connection is about; -1: none"),
    Column("kind", "string", "the kind of packet: ins, rep, ..., scan, pose; malformed"),
    Column("packets", "int32", "number of packets"),
    Column("bytes", "int32", "bytes of these packets"),
    Column("carried", "bool", "whether they were on the air"),
    Column("cause", "string", "why not, or why nobody heard them; empty if all went well"),
    Column("heard", "int16", "number of robots that received them"),
)
"""One row per frame and kind of packet in it (``ledger.parquet``)."""

MAP_CHANGES = (
    Column("robot", "int16", "the robot whose maps changed"),
    Column("step", "int32", "the step at whose end the cell had this value; reported every five steps"),
    Column("x", "int16", "the cell's column"),
    Column("y", "int16", "the cell's row, from the top"),
    Column("own", "uint8", "the cell on the robot's own map: 0 unknown, 1 free, 2 occupied"),
    Column("planning", "uint8", "the cell on its planning map, which includes its teammates' maps"),
)
"""One row per cell that changed (``map_changes.parquet``)."""

OUTLINES = (
    Column("robot", "int16", "the robot that holds the outlines"),
    Column("step", "int32", "the step at whose end they had changed"),
    Column("map", "int16", "the robot whose map they describe"),
    Column("vertices", "binary", "int16 rows of four (`protocol.messages.Outlines`)"),
)
"""One row per set of outlines that changed (``outlines.parquet``); only if maps travel as polygons."""

FILES = {
    "steps.parquet": STEPS,
    "ledger.parquet": LEDGER,
    "map_changes.parquet": MAP_CHANGES,
    "outlines.parquet": OUTLINES,
}


def schema(columns: tuple[Column, ...]) -> Any:
    """The arrow schema of such columns."""
    import pyarrow as pa  # noqa: PLC0415  half a second that the command line need not wait for

    return pa.schema([(column.name, pa.type_for_alias(column.type)) for column in columns])
