"""Packets that say how far a log has come: what one holds of it, and from which unit on others follow.

Gossip says them, and so do sessions on media that lose. A unit's number travels whole while it is small (`EARLY`),
later modulo `GOSSIP_WINDOW`: what is meant is the nearest to what one holds.
"""

from __future__ import annotations

from protocol import packets
from protocol.packets import EARLY, GOSSIP_WINDOW, From, FromEarly, Held, HeldEarly


def number(said: From | FromEarly | Held | HeldEarly, held: int) -> int:
    """The number of the unit that is meant, by one who holds so many."""
    if isinstance(said, FromEarly | HeldEarly):
        return said.index
    return max(0, held + (said.index - held + GOSSIP_WINDOW // 2) % GOSSIP_WINDOW - GOSSIP_WINDOW // 2)


def report(piece: bytes) -> packets.AnyPacket | None:
    """Read a packet that is no unit of a log."""
    return packets.decode(piece)[0] if packets.name(piece) == From.name else None


def from_packet(map_id: int, index: int) -> From | FromEarly:
    """The shortest packet that says of which log, and from which unit on, units follow."""
    return FromEarly(map_id, index) if index < EARLY else From(map_id, index % GOSSIP_WINDOW)


def held_packet(map_id: int, index: int) -> Held | HeldEarly:
    """The shortest packet that says how many units of a log one holds."""
    return HeldEarly(map_id, index) if index < EARLY else Held(map_id, index % GOSSIP_WINDOW)
