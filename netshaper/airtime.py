"""Airtime: how many bytes each robot may still send and receive in a step, and the order of senders.

On a medium with carrier sense, high priorities are served first. `Shares` prevents starvation: a robot that used more
than half of the recent airtime sends after all others.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping, Sequence
from functools import reduce

from netshaper.settings import RadioSettings
from protocol.budget import UNLIMITED, Budget
from protocol.nanoseconds import SECOND
from protocol.packet_index import PacketIndex
from protocol.packets import Pose, Target
from protocol.token_bucket import TokenBucket

RECENT = 8
"""Time constant, in steps, of the exponential average of bytes that a robot sent."""

BROADCAST_PART = 6
"""Broadcasts of poses and targets take at most this part of the budget, but at least the share of one robot."""


class BroadcastShare:
    """Bytes that all broadcasts of poses and targets may take together, where they share the medium with maps.

    The budget of a step is divided equally among the maps of all robots and the broadcasts. The first broadcast of a
    step may exceed this share, or none would fit into a narrow one. If it takes more than the part `BROADCAST_PART` of
    the budget, the next steps pay for it: maps go first until then. They also pay for what a step leaves of its budget
    because no packet of a map fits beside broadcasts. States of teammates that a robot relays in its broadcast are not
    paid for, since they would be too old later.
    """

    def __init__(self) -> None:
        self._share = 0
        """Bytes that further broadcasts of this step may take."""
        self._left = 0
        """Bytes that first broadcasts may take; 0 or less: earlier ones are still to be paid for."""

    def next_step(self, limit: int, robots: int) -> None:
        """Add the share of a step, given its budget in bytes and the number of robots on the medium."""
        self._share = limit // (robots + 1)
        part = max(limit // BROADCAST_PART, self._share, 1)
        self._left = min(self._left + part, part)

    @property
    def owes(self) -> bool:
        """Whether earlier broadcasts are still to be paid for."""
        return self._left <= 0

    def fits(self, size: int) -> bool:
        """Return whether a further broadcast of `size` bytes is within the share of this step."""
        return size <= self._share

    def book(self, size: int) -> None:
        """Record that broadcasts took `size` bytes."""
        self._left -= min(size, Pose.size + Target.size)
        self._share -= size

    def book_unused(self, size: int) -> None:
        """Record that a step left `size` bytes of its budget because no packet of a map fitted beside broadcasts."""
        self._left -= size


class Shares:
    """Recent airtime of each robot, and of all broadcasts of poses and targets (`broadcasts`)."""

    def __init__(self) -> None:
        self.broadcasts = BroadcastShare()
        self._sent: Counter[int] = Counter()

    def rank(self, robot: int, priority: int, budget: Budget) -> tuple[bool, int]:
        """Return the rank of a robot's frames, given the budget of a step: the lowest is sent first."""
        over_half = budget.limit is not None and 2 * self._sent[robot] > budget.limit * RECENT
        return over_half, -priority

    def book(self, robot: int, size: int) -> None:
        """Record that a robot has sent `size` bytes."""
        self._sent[robot] += size

    def next_step(self) -> None:
        """Discount older bytes."""
        for robot in self._sent:
            self._sent[robot] = self._sent[robot] * (RECENT - 1) // RECENT


HOUR_S = 3600
"""Seconds over which a duty cycle holds."""

WHOLE_STEP = 1_000_000_000
"""Airtime of a whole step, in the units of `DutyCycle`."""


class DutyCycle:
    """The airtime of a robot within the last hour, at most a share of the hour (ETSI EN 300 220).

    A robot may use its whole share at once; each transmission then counts for an hour. `share`: share of the hour in
    which the robot may send; `hour`: steps of an hour.
    """

    def __init__(self, share: float, hour: int) -> None:
        self._hour = hour
        self._step = 0
        self._left = round(share * hour * WHOLE_STEP)
        """Airtime that the robot may still use."""
        self._used: deque[tuple[int, int]] = deque()
        """The step and the airtime of each transmission of the last hour."""

    def next_step(self) -> None:
        """Begin a step, and forget transmissions that are an hour old."""
        self._step += 1
        while self._used and self._used[0][0] <= self._step - self._hour:
            self._left += self._used.popleft()[1]

    def room(self, bandwidth: int) -> int:
        """Return how many bytes the robot may send, at a rate of so many bytes per step."""
        return max(0, self._left * bandwidth // WHOLE_STEP)

    def take(self, size: int, bandwidth: int) -> None:
        """Count the airtime of `size` bytes, at a rate of so many bytes per step."""
        airtime = -(-size * WHOLE_STEP // bandwidth)
        self._left -= airtime
        self._used.append((self._step, airtime))


class Airtime:
    """Budgets of a step: the shared one, and those of each robot.

    A byte takes airtime of its sender and of all robots in range. With one shared budget these are all robots; with
    spatial reuse a byte counts only in the sender's neighborhood, and no neighborhood exceeds the budget. Each budget
    is a token bucket that a step refills.
    """

    def __init__(self, settings: RadioSettings) -> None:
        options, robots = settings.options, settings.robots
        self._reuse = options.reuse
        self._saving = settings.saving
        self._now = 0
        """The time in nanoseconds, if a step lasts a second."""
        self._senders = [self._bucket(most) for most in settings.send or [options.send_bytes] * robots]
        """Bytes that each robot itself can send; None: no limit."""
        self._can_receive = settings.receive or [options.receive_bytes] * robots
        """Bytes per step that each robot can receive; 0: no limit."""
        self.limits_reception = any(self._can_receive)
        """Whether a robot's reception is limited."""
        self._robots = robots
        share, hour = options.duty_cycle, HOUR_S * self._saving.steps
        self._duty_cycles = [DutyCycle(share, hour) for _ in range(robots)] if share < 1 else []
        self.set_budget(settings.budget)
        self._neighbors: Mapping[int, Sequence[int]] = {}
        self._buckets: list[list[TokenBucket]] = [[] for _ in range(robots)]
        """The buckets from which each robot's bytes are taken in this step."""
        self.left = settings.budget
        """The remaining budget that the whole team shares."""
        self._received = [0] * robots

    def _bucket(self, rate: int) -> TokenBucket | None:
        """Return a bucket of `rate` bytes per step; None if that is 0."""
        return TokenBucket(rate, self._saving.capacity(rate), self._now) if rate else None

    def set_budget(self, budget: Budget) -> None:
        """Change the budget from the next step on; the airtime of duty cycles stays."""
        self._budget = budget
        self._around = [self._bucket(budget.limit or 0) for _ in range(self._robots if self._reuse else 1)]
        """Bytes that may be sent around each robot, with spatial reuse, else by the team; None: none, or no limit."""

    def next_step(self, neighbors: Mapping[int, Sequence[int]]) -> None:
        """Begin a step, with the robots in range of each."""
        self._neighbors = neighbors
        self._now += SECOND
        for bucket in (*self._around, *self._senders):
            if bucket is not None:
                bucket.room(self._now)
        for robot, own in enumerate(self._senders):
            around = (robot, *neighbors.get(robot, ())) if self._reuse else (0,)
            buckets = own, *map(self._around.__getitem__, around)
            self._buckets[robot] = [bucket for bucket in buckets if bucket is not None]
        self.left = self._left_around(0)
        self._received = [0] * self._robots
        for duty_cycle in self._duty_cycles:
            duty_cycle.next_step()

    def _left_around(self, robot: int) -> Budget:
        bucket = self._around[robot]
        return self._budget if bucket is None else Budget(bucket.left)

    def shared(self, robot: int) -> Budget:
        """Return the remaining budget that a robot shares with others."""
        if not self._reuse or self._budget.unlimited:
            return self.left
        around = map(self._left_around, (robot, *self._neighbors.get(robot, ())))
        return reduce(Budget.least, around)

    def own(self, robot: int) -> Budget:
        """Return the remaining bytes that a robot itself can send."""
        bucket = self._senders[robot]
        left = UNLIMITED if bucket is None else Budget(bucket.left)
        if self._duty_cycles and self._budget.limit is not None:
            left = left.least(Budget(self._duty_cycles[robot].room(self._budget.limit)))
        return left

    def room(self, robot: int) -> Budget:
        """Return how many bytes a robot may send."""
        return self.shared(robot).least(self.own(robot))

    def book(self, robot: int, size: int) -> None:
        """Record that a robot has sent `size` bytes."""
        self.left = self.left.minus(size)
        for bucket in self._buckets[robot]:
            bucket.take(size)
        if self._duty_cycles and self._budget.limit:
            self._duty_cycles[robot].take(size, self._budget.limit)

    def receives(self, robot: int, size: int) -> bool:
        """Record that a robot receives `size` bytes; return False if they exceed its limit."""
        most = self._can_receive[robot]
        if most and self._received[robot] + size > most:
            return False
        self._received[robot] += size
        return True


def cut_into_frames(index: PacketIndex, room: Budget, frame_limit: Budget, tail: int) -> list[int]:
    """Cut packets into frames for the air, within the remaining budget `room`.

    A frame has at most `frame_limit` bytes, the `tail` bytes after its packets included.

    Returns for each frame, in order, the number of the packet after its last one. Packets after the last frame did not
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
