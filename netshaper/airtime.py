"""Who speaks how long: the air of one exchange shared among robots that all have something to broadcast.

As on a medium where everyone listens before speaking: the more urgent what one has to say, the shorter one waits. What
finds no room is cut at a packet boundary, and whoever has a shorter packet may still use the rest. Who has had more
than half of the air of late waits longer than all others (`Shares`), so that nobody can shout the others down.
"""

from __future__ import annotations

from collections.abc import Sequence

from protocol import survey

UNLIMITED = -1

LATE = 8
"""Steps that count as of late, more or less: what was said before fades."""

MOST_URGENT = 255
"""How urgent anything can be; who says more is believed no more."""


def fill(payloads: Sequence[bytes], left: int) -> list[int]:
    """Return how many bytes of each frame go on the air, given in the order of speaking; `left`: the budget's rest."""
    sizes = []
    for payload in payloads:
        size = len(payload) if left == UNLIMITED else survey.fitting(payload, left)
        if left != UNLIMITED:
            left -= size
        sizes.append(size)
    return sizes


class Shares:
    """How much each robot has had of the air of late.

    Parameters
    ----------
    budget : int
        Bytes a step that all share.
    """

    def __init__(self, budget: int) -> None:
        self._budget = budget
        self._had: dict[int, int] = {}

    def rank(self, robot: int, urgency: int) -> tuple[bool, int]:
        """What decides who speaks first: the least."""
        shouts = self._budget != UNLIMITED and 2 * self._had.get(robot, 0) > self._budget * LATE
        return shouts, -min(max(urgency, 0), MOST_URGENT)

    def book(self, robot: int, size: int) -> None:
        """A robot has had so many bytes of the air."""
        self._had[robot] = self._had.get(robot, 0) + size

    def next_step(self) -> None:
        """Let what was said fade."""
        self._had = {robot: had * (LATE - 1) // LATE for robot, had in self._had.items()}
