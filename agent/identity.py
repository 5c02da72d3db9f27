"""The identity of a robot across restarts: incarnation numbers, persisted in a journal, and map IDs.

A robot that crashes loses its state except for its journal: its incarnations so far, and its start cell. Incarnations
have numbers, like the epochs of a restarted process in other distributed systems (for example SWIM, Das et al. 2002).
Each one begins a new log with a new map ID (`agent.replication.peers`). Packets have a limited number of map IDs
(`protocol.packets.MAX_MAPS`), which bounds robots times incarnations.

The log of an earlier incarnation stays valid. Teammates continue to forward it to all robots that lack it, so the
restarted robot recovers its former map. A teammate that receives a newer incarnation number forgets which entries the
robot held.
"""

from __future__ import annotations

import msgspec
from msgspec.structs import replace

from agent.journal import Journal, JournalError
from agent.settings import Settings
from protocol.grid import Cell


class Incarnation(msgspec.Struct, frozen=True, tag=True, array_like=True, forbid_unknown_fields=True):
    """Journal record: an incarnation of a robot begins."""

    robot: int
    robots: int
    incarnation: int


class Home(msgspec.Struct, frozen=True, tag=True, array_like=True, forbid_unknown_fields=True):
    """Journal record: the start cell of the first incarnation."""

    x: int
    y: int


_read = msgspec.msgpack.Decoder(Incarnation | Home).decode
_write = msgspec.msgpack.Encoder().encode


class Identity:
    """Incarnations of one robot, as its journal records them, each before it sends anything."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._home: Cell | None = None

    def begin(self, settings: Settings) -> Settings:
        """Begin an incarnation: record it, and return the settings with its number and the home cell.

        JournalError: the journal is malformed or belongs to another robot, or the robot has used up its incarnations.
        """
        robot, robots, incarnation = settings.robot, settings.robots, 0
        for number, record in enumerate(self._journal.records):
            entry = _entry(record, number)
            if isinstance(entry, Home):
                if not (0 <= entry.x < settings.width and 0 <= entry.y < settings.height):
                    raise JournalError(f"record {number}: home is at ({entry.x}, {entry.y}), outside the map")
                self._home = entry.x, entry.y
            elif entry != Incarnation(robot, robots, incarnation):
                found = f"incarnation {entry.incarnation} of robot {entry.robot} of {entry.robots}"
                expected = f"incarnation {incarnation} of robot {robot} of {robots}"
                raise JournalError(f"record {number}: {found}, expected {expected}")
            else:
                incarnation += 1
        if incarnation >= settings.incarnations:
            raise JournalError(f"robot {robot} has used up its {settings.incarnations} incarnations")
        self._journal.append(_write(Incarnation(robot, robots, incarnation)))
        return replace(settings, incarnation=incarnation, home=self._home)

    def settle(self, x: int, y: int) -> None:
        """Record the start cell of the first incarnation as home; later calls do nothing."""
        if self._home is None:
            self._home = x, y
            self._journal.append(_write(Home(x, y)))


def _entry(record: bytes, number: int) -> Incarnation | Home:
    try:
        entry: Incarnation | Home = _read(record)
        return entry
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
        raise JournalError(f"record {number}: not a journal entry: {error}") from None
