"""Who speaks how long: the air of one exchange shared among robots that all have something to broadcast.

As a medium does it on which everyone listens before speaking: who waits the shortest time begins, and nobody speaks for
more than half of what is left of the step before all others have had their turn. What does not fit is cut at a
packet boundary, and whoever has a shorter packet may still use the rest.
"""

from __future__ import annotations

from collections.abc import Sequence

from protocol import packets

UNLIMITED = -1


def shares(payloads: Sequence[bytes], left: int) -> list[int]:
    """Return how many bytes of each frame go on the air, given in the order of speaking, with `left` bytes of budget."""
    if left == UNLIMITED:
        return [len(payload) for payload in payloads]
    sizes = [0] * len(payloads)
    most = left // 2 if len(payloads) > 1 else left
    for limit in (most, left):
        for turn, payload in enumerate(payloads):
            rest = payload[sizes[turn] :]
            if rest and limit:
                room = min(left, max(limit, packets.length(rest)))
                size = packets.fitting(rest, room)
                sizes[turn] += size
                left -= size
    return sizes
