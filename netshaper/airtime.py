"""Who speaks how long: the air of one exchange shared among robots that all have something to broadcast.

As on a medium where everyone listens before speaking: the more urgent what one has to say, the shorter one waits. What
finds no room is cut at a packet boundary, and whoever has a shorter packet may still use the rest. Who has had more
than half of the air of late waits longer than all others (`Shares`), so that nobody can shout the others down.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from protocol import packet_index

UNLIMITED = -1

LATE = 8
"""Steps that count as of late, more or less: what was said before fades."""

MOST_URGENT = 255
"""How urgent anything can be; who says more is believed no more."""


def fill(payloads: Sequence[bytes], left: int) -> list[int]:
    """Return how many bytes of each frame go on the air, given in the order of speaking; `left`: the budget's rest."""
    sizes = []
    for payload in payloads:
        size = len(payload) if left == UNLIMITED else packet_index.fitting(payload, left)
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
        self.budget = budget
        self._had: dict[int, int] = {}

    def rank(self, robot: int, priority: int) -> tuple[bool, int]:
        """What decides who speaks first: the least."""
        shouts = self.budget != UNLIMITED and 2 * self._had.get(robot, 0) > self.budget * LATE
        return shouts, -min(max(priority, 0), MOST_URGENT)

    def book(self, robot: int, size: int) -> None:
        """A robot has had so many bytes of the air."""
        self._had[robot] = self._had.get(robot, 0) + size

    def next_step(self) -> None:
        """Let what was said fade."""
        self._had = {robot: had * (LATE - 1) // LATE for robot, had in self._had.items()}


HOUR = 3600
"""Steps over which a duty cycle is kept."""


class Airtime:
    """How much each robot may still put on the air in a step, and how much it can still take.

    A byte takes the air of who says it and of all in range of it. With one budget for all that is everybody; with a
    budget of each neighbourhood nobody has more than a budget's worth of bytes around it.

    Parameters
    ----------
    budget : int
        Bytes a step; `UNLIMITED` for no limit.
    robots : int
    reuse : bool
        Whether each neighbourhood has the budget, or the team.
    send, receive : sequence of int
        Bytes a step that each robot can send, and take; 0: no limit.
    duty_cycle : float
        Share of an hour's bytes that each robot may send: saved up for an hour, and full at first.
    """

    def __init__(
        self,
        budget: int,
        robots: int,
        *,
        reuse: bool = False,
        send: Sequence[int] = (),
        receive: Sequence[int] = (),
        duty_cycle: float = 1.0,
    ) -> None:
        self._duty_cycle = duty_cycle
        self._reuse = reuse
        self._most_sent = send or [0] * robots
        self._most_taken = receive or [0] * robots
        self.set_budget(budget)
        self._saved = [HOUR * (self._earned or 0.0)] * robots
        self._around: Mapping[int, Sequence[int]] = {}
        self._used = self._sent = self._taken = [0] * robots

    def set_budget(self, budget: int) -> None:
        """Have another budget from now on; what has been saved up stays."""
        self._budget = budget
        limited = self._duty_cycle < 1 and budget != UNLIMITED
        self._earned = self._duty_cycle * budget if limited else None

    def next_step(self, around: Mapping[int, Sequence[int]]) -> None:
        """Open the air for a step, with the robots in range of each."""
        self._around = around
        robots = len(self._used)
        self._used, self._sent, self._taken = [0] * robots, [0] * robots, [0] * robots
        if self._earned is not None:
            self._saved = [min(saved + self._earned, HOUR * self._earned) for saved in self._saved]

    def shared(self, robot: int) -> int:
        """What is left for a robot of the budget that it shares, `UNLIMITED` for no limit."""
        if self._budget == UNLIMITED:
            return UNLIMITED
        return self._budget - max(self._used[each] for each in (robot, *self._sharing(robot)))

    def own(self, robot: int) -> int:
        """What is left of what a robot itself can send, `UNLIMITED` for no limit."""
        limits = []
        if self._most_sent[robot]:
            limits.append(self._most_sent[robot] - self._sent[robot])
        if self._earned is not None:
            limits.append(int(self._saved[robot]))
        return min(limits, default=UNLIMITED)

    def room(self, robot: int) -> int:
        """What a robot may put on the air, `UNLIMITED` for no limit."""
        return least(self.shared(robot), self.own(robot))

    def book(self, robot: int, size: int) -> None:
        """A robot has put so many bytes on the air."""
        for each in (robot, *self._sharing(robot)):
            self._used[each] += size
        self._sent[robot] += size
        if self._earned is not None:
            self._saved[robot] -= size

    def takes(self, robot: int, size: int) -> bool:
        """Whether a robot can take so many bytes more; then it has."""
        most = self._most_taken[robot]
        if most and self._taken[robot] + size > most:
            return False
        self._taken[robot] += size
        return True

    def _sharing(self, robot: int) -> Sequence[int]:
        """Who shares the air with a robot."""
        everyone = range(len(self._used))
        return self._around.get(robot, ()) if self._reuse else [each for each in everyone if each != robot]


def least(one: int, other: int) -> int:
    """The smaller of two limits, of which `UNLIMITED` is none."""
    return max(one, other) if UNLIMITED in (one, other) else min(one, other)


def cut_into_frames(payload: bytes, room: int, most: int, tail: int) -> tuple[list[bytes], bytes]:
    """Cut packets into frames for the air.

    Parameters
    ----------
    payload : bytes
        Whole packets.
    room : int
        Bytes that there is room for, `UNLIMITED` for no limit.
    most : int
        Bytes that a frame holds at most, 0 for no limit.
    tail : int
        Bytes that each frame has behind its packets.

    Returns
    -------
    (frames, rest): as many whole packets as there is room for, without the tails, and those that found none.
    """
    frames: list[bytes] = []
    rest = payload
    while rest:
        limit = least(room, most or UNLIMITED)
        size = len(rest) if limit == UNLIMITED else packet_index.fitting(rest, limit - tail)
        if not size:
            break
        frames.append(rest[:size])
        rest = rest[size:]
        if room != UNLIMITED:
            room -= size + tail
    return frames, rest
