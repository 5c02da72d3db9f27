"""Cut updates of the predictive encoding into packets, and limit the bytes that a step encodes.

Both depend on the budget of a step. A packet that does not fit into the rest of a budget leaves that rest unused, so
packets are short: the budget holds `PACKETS_A_STEP` of them.

On a very narrow medium, one packet fills the budget instead: if the budget cannot hold a target and two packets, or is
narrow and updates contain tiles. This requires that all robots are always in range of each other. Room remains for the
longest header that names a packet's offset in its log (`FromEarly`, or `From` behind offset `EARLY`). It is needed only
after a restart, so in other steps a target fits there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from agent.settings import Settings
from protocol.packet_codec import encode
from protocol.packets import (
    EARLY,
    LENGTH_HEAD,
    SHORT_UPDATE_DATA,
    UPDATE_DATA,
    UPDATE_NUMBERS,
    UPDATE_PART,
    From,
    FromEarly,
    Target,
    Update,
)

ENOUGH_STEPS = 4
"""Steps for which fewer new cells wait at most, if bandwidth is scarce."""

FAIR_SHARE = 28
"""Bytes per robot and step for which they wait one step; with half of it they wait two steps, and so on."""

PACKETS_A_STEP = 3
"""Packets that the budget of a step holds, unless it is very small."""

SHORTEST = 1 + UPDATE_PART
"""Bytes of the shortest packet that another one of the same update follows."""

NARROW = 42
"""Bytes per step below which scans are coded by better predictions (`agent.predictive.scan_stream.NarrowBand`), and
updates of tiles are long (`agent.predictive.narrow_tile_author`)."""

NARROW_APART = 250
"""The same limit for scans if robots may leave each other's range: each update is then sent several times, to robots
that meet."""

FULL_STEPS = 2
"""Steps of which a full update of scans on a narrow medium takes the budget. With more, robots wait longer for their
turn."""

FULL_TILE_STEPS = 4
"""The same for an update of tiles, which begins with more bytes of its own."""

LONG_FRAGMENT = 32
"""Bytes of content of a packet from which updates of tiles, most of which take several packets, are split into packets
of equal size. Below, short fragments fill the budget of a step better."""


@dataclass(frozen=True)
class UpdateLimits:
    """Sizes and waiting times that depend on the bandwidth."""

    packet_bytes: int
    """The most bytes of content of a packet."""
    fragment_bytes: int
    """Bytes of content of a packet that another one of the same update follows."""
    step_bytes: float
    """Bytes after which a step encodes no more: changes that wait can still be merged with later ones.

    If `is_narrow`, the limit of an update: `FULL_STEPS` or `FULL_TILE_STEPS` budgets; with `fills`, as many packets.
    """
    wait_steps: int
    """Steps for which few new cells wait (`ENOUGH_STEPS`)."""
    fills: int = 0
    """The budget of a step that one packet fills; 0: packets are shorter.

    With such a budget, only one robot sends updates in a step, and updates rank by their new cells per byte.
    """
    full_steps: int = 1
    """Steps of which a full update takes the budget."""
    is_narrow: bool = False
    """Whether the budget of a step is below `NARROW`, or `NARROW_APART`."""

    @classmethod
    def of(cls, settings: Settings) -> UpdateLimits:
        """Derive the limits from the team's budget and the frame size."""
        medium, has_tiles = settings.medium, settings.shares_tiles
        bandwidth, frame_bytes = medium.bandwidth.limit, medium.frame_bytes
        size = UPDATE_DATA
        if bandwidth is not None:
            size = min(size, content_in(bandwidth // PACKETS_A_STEP))
        if frame_bytes is not None:
            size = min(size, content_in(frame_bytes))
        size = max(size, UPDATE_PART)
        fragment_bytes = size if has_tiles and size >= LONG_FRAGMENT else UPDATE_PART
        if bandwidth is None:
            return cls(size, fragment_bytes, step_bytes=math.inf, wait_steps=1)
        hear_all = medium.reach_cells > math.hypot(settings.width, settings.height) - 1
        fills, full_steps, step_bytes = 0, 1, max(bandwidth, 1)
        is_filled = bandwidth < (NARROW if has_tiles else Target.size + 2 * SHORTEST)
        if is_filled and hear_all and not settings.replication.requires_acks:
            fills = bandwidth if frame_bytes is None else min(bandwidth, frame_bytes)
        is_narrow = bandwidth < (NARROW if hear_all or has_tiles else NARROW_APART)
        if is_narrow:
            content = max(size, content_in(fills - FromEarly.size)) if fills else step_bytes
            full_steps = FULL_TILE_STEPS if has_tiles else FULL_STEPS
            step_bytes = full_steps * content
        scarcity = FAIR_SHARE * settings.robots / max(bandwidth, 1)
        wait_steps = min(max(math.ceil(scarcity), 1), ENOUGH_STEPS)
        return cls(size, fragment_bytes, step_bytes, wait_steps, fills, full_steps, is_narrow)

    def packets(self, message: bytes, number: int, offset: int) -> list[bytes]:
        """Split update `number` of a log into packets, the first of which has this offset in the log."""
        last = offset + len(message) // UPDATE_PART
        header = FromEarly if last < EARLY else From
        filling = content_in(self.fills - header.size)
        if filling > self.packet_bytes:
            return fragments(message, number, filling, filling)
        return fragments(message, number, self.packet_bytes, self.fragment_bytes)


def content_in(size: int) -> int:
    """Return how many bytes of content a packet of at most `size` bytes has."""
    return max(min(size - 1, SHORT_UPDATE_DATA), size - LENGTH_HEAD)


def fragments(message: bytes, number: int, most: int, size: int = UPDATE_PART) -> list[bytes]:
    """Split an update into packets of `size` bytes of content, and a last one of at most `most` bytes."""
    packets = []
    while len(message) > most:
        part, message = message[:size], message[size:]
        packets.append(Update(None, part))
    return [encode([packet]) for packet in (*packets, Update(number % UPDATE_NUMBERS, message))]
