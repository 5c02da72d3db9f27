"""The identity of a robot across restarts: incarnation numbers, persisted in a journal, and map IDs.

A robot that crashes loses its state. On stable storage it keeps its journal: the number of its incarnations so far, and
its start cell. Each incarnation has a number, as in distributed systems that distinguish the epochs of a restarted
process (for example SWIM, Das et al. 2002). An incarnation begins a new log with a new map ID. With `r` robots,
incarnation `i` of robot `n` has map ID `n + i * r`. So a map ID shows the robot and its incarnation, and frames need no
further bytes for it.

The log of an earlier incarnation stays valid. Teammates continue to forward it to all robots that lack it. So the
restarted robot recovers its former map. A teammate that receives a newer incarnation number knows that the
robot has lost its state, and begins anew with it.

Packets have a limited number of map IDs (`protocol.packets.MAX_MAPS`), which bounds robots times incarnations.
"""

from __future__ import annotations

import msgspec
from msgspec.structs import replace

from agent.journal import Journal, JournalError
from agent.settings import Settings


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
    """Incarnations of one robot, as its journal records them.

    Parameters
    ----------
    journal : Journal
        Records of the earlier incarnations; empty for the first. An incarnation is recorded before it sends anything.
    """

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._home: tuple[int, int] | None = None

    def begin(self, settings: Settings) -> Settings:
        """Begin an incarnation: record it, and return the settings with its number and the home cell.

        Raises
        ------
        JournalError
            The journal is malformed or belongs to another robot, or the robot has used up its incarnations.
        """
        incarnation = 0
        for number, record in enumerate(self._journal.records):
            entry = _entry(record, number)
            if isinstance(entry, Home):
                if not (0 <= entry.x < settings.width and 0 <= entry.y < settings.height):
                    raise JournalError(f"record {number}: home is at ({entry.x}, {entry.y}), outside the map")
                self._home = entry.x, entry.y
            elif (entry.robot, entry.robots, entry.incarnation) != (
                settings.robot,
                settings.robots,
                incarnation,
            ):
                found = f"incarnation {entry.incarnation} of robot {entry.robot} of {entry.robots}"
                expected = f"incarnation {incarnation} of robot {settings.robot} of {settings.robots}"
                raise JournalError(f"record {number}: {found}, expected {expected}")
            else:
                incarnation += 1
        if incarnation >= settings.incarnations:
            raise JournalError(f"robot {settings.robot} has used up its {settings.incarnations} incarnations")
        self._journal.append(_write(Incarnation(settings.robot, settings.robots, incarnation)))
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
    except (msgspec.DecodeError, msgspec.ValidationError, RecursionError, UnicodeDecodeError) as error:
        raise JournalError(f"record {number}: not a journal entry: {error}") from None
