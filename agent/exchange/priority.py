"""How soon what a robot gossips should be on the air: the more urgent, the shorter it waits for a free medium.

Where all have always heard each other: who has begun a unit, and then who has most to say. Else who serves one that
holds most. Both become more urgent the longer they wait.
"""

from __future__ import annotations

MOST_URGENT = 255

KEEPING_UP = 64
"""Units: who lacks fewer is served more urgently, and the more so the fewer."""

LONG = 64
"""Bytes of news that are more urgent the more there are."""

AGING = 2
"""What a step of waiting adds to the urgency."""

HOLDS = 4
"""Units that who is served holds, for each of which as many one is more urgent, where robots have been out of range."""

HOLDS_MOST = 200
"""The most that this adds."""


def among_all(lacks: int, length: int, waited: int, *, begun: bool) -> int:
    """How urgent it is where nobody has ever been out of range.

    Parameters
    ----------
    lacks : int
        Units that who is served first lacks, 0 if nobody is.
    length : int
        Bytes to be said.
    waited : int
        Steps since something of one's own was last on the air.
    begun : bool
        Whether a part of what was last recorded has been on the air, and not all of it.
    """
    if begun:
        return MOST_URGENT
    return _aged(max(0, KEEPING_UP - lacks) + min(LONG, length), waited)


def among_some(holds: int, waited: int) -> int:
    """How urgent it is where some have been out of range; `holds`: units that who is served first holds."""
    return _aged(min(HOLDS_MOST, holds // HOLDS), waited)


def _aged(priority: int, waited: int) -> int:
    return min(MOST_URGENT - 1, priority + AGING * waited)
