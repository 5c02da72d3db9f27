"""Who a robot is across its lives: what its journal says of it, and the number of its map.

A robot that was killed and comes back has lost what it knew. Of its own it has its journal: how often it has begun,
and where home is. In its new life it keeps a new log, of a new number (`Settings.own_map`): of `r` robots, robot `n`
tells map `n` in its first life, `n + r` in its second, and so on. So a number says whose map it is, and of which
life, and who hears it tells an old life from a new one, at no byte. The old life's log is the map of a robot that is
gone: teammates go on passing it on, to all who lack it and to its maker as well, who so gets back what it had told.
Who hears that a teammate tells of a new life knows that all that the teammate had been told is lost, and begins anew
with it (`agent.replication`).

Packets can name so many maps (`protocol.packets.MAX_MAPS`); that bounds robots times lives.
"""

from __future__ import annotations

import msgspec
from msgspec.structs import replace

from agent.journal import Journal, JournalError
from agent.settings import Settings


class Incarnation(msgspec.Struct, frozen=True, tag=True, array_like=True, forbid_unknown_fields=True):
    """A robot begins a life."""

    robot: int
    robots: int
    incarnation: int


class Home(msgspec.Struct, frozen=True, tag=True, array_like=True, forbid_unknown_fields=True):
    """Cell in which a robot's first life began."""

    x: int
    y: int


_read = msgspec.msgpack.Decoder(Incarnation | Home).decode
_write = msgspec.msgpack.Encoder().encode


class Identity:
    """One robot's journal, as it reads it; a robot that has none begins its first life.

    Parameters
    ----------
    journal : Journal
        What its earlier lives have written; each new life is written down before it says anything.
    """

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._home: tuple[int, int] | None = None

    def begin(self, settings: Settings) -> Settings:
        """Begin a life: return the settings with what is the robot's own.

        Raises
        ------
        JournalError
            The journal is that of another robot, makes no sense, or the robot has no life left.
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
                whose = f"life {entry.incarnation} of robot {entry.robot} of {entry.robots}"
                wanted = f"life {incarnation} of robot {settings.robot} of {settings.robots}"
                raise JournalError(f"record {number}: {whose}, where {wanted} is the next")
            else:
                incarnation += 1
        if incarnation >= settings.incarnations:
            raise JournalError(f"robot {settings.robot} has used up its lives: {settings.incarnations}")
        self._journal.append(_write(Incarnation(settings.robot, settings.robots, incarnation)))
        return replace(settings, incarnation=incarnation, home=self._home)

    def settle(self, x: int, y: int) -> None:
        """Note where the robot is as it begins; home is where it first did so."""
        if self._home is None:
            self._home = x, y
            self._journal.append(_write(Home(x, y)))


def _entry(record: bytes, number: int) -> Incarnation | Home:
    try:
        entry: Incarnation | Home = _read(record)
        return entry
    except (msgspec.DecodeError, msgspec.ValidationError, RecursionError, UnicodeDecodeError) as error:
        raise JournalError(f"record {number}: no entry of a robot's journal: {error}") from None
