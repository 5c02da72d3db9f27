"""Airtime: how many bytes each robot may still send and receive in a step, and who sends first.

A medium on which everyone listens before sending serves high priorities first. `Shares` keeps a robot from crowding
the others out: a robot that had more than half of the recent airtime waits for all others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from protocol.budget import UNLIMITED, Budget
from protocol.packet_index import PacketIndex

RECENT = 8
"""Steps that count as recent, roughly: what a robot sent before fades."""

MAX_PRIORITY = 255
"""The highest priority; a robot that claims a higher one gets this one."""


class Shares:
    """How much each robot had of the recent airtime.

    Parameters
    ----------
    budget : Budget
        Bytes per step that all robots share.
    """

    def __init__(self, budget: Budget) -> None:
        self.budget = budget
        self._sent: dict[int, int] = {}

    def rank(self, robot: int, priority: int) -> tuple[bool, int]:
        """Return the rank of a robot's frames: the lowest is sent first."""
        limit = self.budget.limit
        crowds = limit is not None and 2 * self._sent.get(robot, 0) > limit * RECENT
        return crowds, -min(max(priority, 0), MAX_PRIORITY)

    def book(self, robot: int, size: int) -> None:
        """Note that a robot has sent so many bytes."""
        self._sent[robot] = self._sent.get(robot, 0) + size

    def next_step(self) -> None:
        """Let older bytes fade."""
        self._sent = {robot: sent * (RECENT - 1) // RECENT for robot, sent in self._sent.items()}


HOUR = 3600
"""Steps over which a duty cycle is kept."""


class Airtime:
    """Budgets of a step: the shared one, and those of each robot.

    A byte takes airtime of its sender and of all robots in range. With one shared budget these are all robots; with
    spatial reuse a byte counts only in the sender's neighborhood, and no neighborhood exceeds the budget.

    Parameters
    ----------
    budget : Budget
        Bytes per step.
    robots : int
    reuse : bool
        Whether each neighborhood has the budget; else the team has it.
    send, receive : sequence of int
        Bytes per step that each robot can send and receive; 0: no limit.
    duty_cycle : float
        Share of an hour's bytes that each robot may send. It is saved up for at most an hour, and full at first.
    """

    def __init__(
        self,
        budget: Budget,
        robots: int,
        *,
        reuse: bool = False,
        send: Sequence[int] = (),
        receive: Sequence[int] = (),
        duty_cycle: float = 1.0,
    ) -> None:
        self._duty_cycle = duty_cycle
        self._reuse = reuse
        self._can_send = send or [0] * robots
        self._can_receive = receive or [0] * robots
        self.set_budget(budget)
        self._saved = [HOUR * (self._earned or 0.0)] * robots
        self._neighbors: Mapping[int, Sequence[int]] = {}
        self._left = budget
        self._used = self._sent = self._received = [0] * robots

    def set_budget(self, budget: Budget) -> None:
        """Change the budget from the next step on; saved airtime stays."""
        self._budget = budget
        limited = self._duty_cycle < 1 and budget.limit is not None
        self._earned = self._duty_cycle * (budget.limit or 0) if limited else None

    def next_step(self, neighbors: Mapping[int, Sequence[int]]) -> None:
        """Begin a step, with the robots in range of each."""
        self._neighbors = neighbors
        robots = len(self._used)
        self._left = self._budget
        self._used, self._sent, self._received = [0] * robots, [0] * robots, [0] * robots
        if self._earned is not None:
            self._saved = [min(saved + self._earned, HOUR * self._earned) for saved in self._saved]

    def shared(self, robot: int) -> Budget:
        """Return what is left of the budget that a robot shares with others."""
        if not self._reuse or self._budget.unlimited:
            return self._left
        around = (robot, *self._neighbors.get(robot, ()))
        return self._budget.minus(max(self._used[each] for each in around))

    def own(self, robot: int) -> Budget:
        """Return what is left of the bytes that a robot itself can send."""
        left = UNLIMITED
        if self._can_send[robot]:
            left = Budget(self._can_send[robot] - self._sent[robot])
        if self._earned is not None:
            left = left.least(Budget(int(self._saved[robot])))
        return left

    def room(self, robot: int) -> Budget:
        """Return how many bytes a robot may send."""
        return self.shared(robot).least(self.own(robot))

    def book(self, robot: int, size: int) -> None:
        """Note that a robot has sent so many bytes."""
        self._left = self._left.minus(size)
        if self._reuse:
            for each in (robot, *self._neighbors.get(robot, ())):
                self._used[each] += size
        self._sent[robot] += size
        if self._earned is not None:
            self._saved[robot] -= size

    def set_left(self, left: Budget) -> None:
        """Note what is left of the budget that the whole team shares."""
        self._left = left

    def receives(self, robot: int, size: int) -> bool:
        """Note that a robot receives so many bytes; False if they exceed its limit."""
        most = self._can_receive[robot]
        if most and self._received[robot] + size > most:
            return False
        self._received[robot] += size
        return True


def cut_into_frames(index: PacketIndex, room: Budget, frame_limit: Budget, tail: int) -> list[int]:
    """Cut packets into frames for the air.

    Parameters
    ----------
    index : PacketIndex
        The packets.
    room : Budget
        Bytes that may be sent.
    frame_limit : Budget
        Bytes that one frame may have.
    tail : int
        Bytes that each frame has behind its packets.

    Returns
    -------
    list of int
        For each frame, in order, the number of the packet behind its last one. Packets behind the last frame did not
        fit.
    """
    stops: list[int] = []
    first = 0
    while first < len(index.ends):
        limit = room.least(frame_limit).limit
        stop = len(index.ends) if limit is None else index.count_fitting(limit - tail, first)
        if stop <= first:
            break
        size = index.bytes_of(first, stop)
        room = room.minus(size.stop - size.start + tail)
        stops.append(stop)
        first = stop
    return stops
