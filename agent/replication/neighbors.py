"""Gossip's tables of the robots in range: meetings, links, and where each robot's next broadcast begins."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, NamedTuple

import numpy as np

from agent.replication.peers import Mask

GREETING = 1
"""Steps after a peer's arrival for which this robot waits for its report."""

Event = Literal["arrived", "reported", "timed out", "informed", "restarted", "left"]


class _Facts(NamedTuple):
    """What an event changes in the meeting with a peer; None: nothing."""

    owes: bool | None = None
    """Whether this robot owes the peer reports."""
    awaits: bool | None = None
    """Whether it waits for a report of the peer."""


TRANSITIONS: dict[Event, _Facts] = {
    "arrived": _Facts(owes=True, awaits=True),
    "reported": _Facts(awaits=False),
    "timed out": _Facts(awaits=False),
    "informed": _Facts(owes=False),
    "restarted": _Facts(owes=True),
    "left": _Facts(owes=False, awaits=False),
}
"""The events of a meeting. *Informed*: the owed reports were on the air. *Restarted*: the peer lost its state."""


class Meetings:
    """The reports that this robot and robots that came into its range must exchange, by `TRANSITIONS`.

    Until a newcomer has reported, or `GREETING` steps have passed, this robot does not send it old entries: it may hold
    them already. `settled`: all start at the same time with empty logs; else everyone in range must report first.
    """

    def __init__(self, robots: int, *, settled: bool) -> None:
        self._arrived: dict[int, int] = dict.fromkeys(range(robots), 0) if settled else {}
        """The step in which each robot in range came there."""
        self._owed: set[int] = set()
        """Peers to which this robot owes reports."""
        self._awaited: set[int] = set()
        """Peers whose report it waits for."""

    def on(self, event: Event, *peers: int) -> None:
        """Follow the transition table, for all of `peers`."""
        for those, fact in zip((self._owed, self._awaited), TRANSITIONS[event], strict=True):
            if fact is not None:
                (those.update if fact else those.difference_update)(peers)

    def begin_step(self, step: int, in_range: Iterable[int]) -> None:
        """Note which peers have left the range and which have come; after `GREETING` steps, await no report."""
        here = set(in_range)
        self.on("left", *self._arrived.keys() - here)
        self.on("arrived", *here - self._arrived.keys())
        self._arrived = {peer: self._arrived.get(peer, step) for peer in here}
        self.on("timed out", *[peer for peer in self._awaited if step > self._arrived[peer] + GREETING])

    def owed(self) -> list[int]:
        """Return the peers to which this robot owes reports, ascending."""
        return sorted(self._owed)

    def known(self, in_range: Iterable[int]) -> list[int]:
        """Return the peers in range whose report is not awaited."""
        return [peer for peer in in_range if peer not in self._awaited]


class Neighbors:
    """Which robots are in range of each other, and so received a broadcast.

    Each robot reports arrivals and departures in its own range (`Near`, `Gone`) until all peers in range have received
    that. Until a robot reports otherwise, it counts as in range of all.
    """

    def __init__(self, robot: int, robots: int) -> None:
        self._robot = robot
        self.in_range: list[int] = []
        """The robots in this robot's range in this step."""
        self.have_parted = False
        """Whether any robot has ever been out of range."""
        self.near: Mask = ~np.eye(robots, dtype=np.bool_)
        """``near[robot, other]``: whether `other` is in a robot's range; as to peers, by their reports."""
        self._informed: Mask = np.arange(robots) != np.full((robots, 1), robot)
        """``_informed[peer, other]``: whether `other` is in this robot's range, by the reports that a peer received;
        true for the peer itself, as only peers in range are informed."""
        self._settled = False
        """Whether `news` found none, and nothing has changed since."""

    def begin_step(self, in_range: list[int]) -> None:
        """Note which robots are in range."""
        self.have_parted |= len(in_range) < len(self.near) - 1
        self._settled &= in_range == self.in_range
        self.in_range = in_range
        self.near[self._robot] = False
        self.near[self._robot, in_range] = True

    def news(self) -> list[tuple[int, bool]]:
        """Return the robots of which a peer in range has an outdated report, and whether each is in range now."""
        if self._settled:
            return []
        here = self.near[self._robot]
        outdated = np.logical_or.reduce(self._informed[self.in_range] != here).nonzero()[0].tolist()
        self._settled = not outdated
        return [(other, bool(here[other])) for other in outdated]

    def inform(self, other: int, here: bool) -> None:
        """Note that the peers in range received this robot's report about another robot."""
        self._informed[self.in_range, other] = here
        self._settled = False

    def receivers(self, sender: int) -> Mask:
        """Return the mask of the robots that know what a robot broadcast: those in its range, and itself."""
        receivers: Mask = self.near[sender].copy()
        receivers[sender] = True
        return receivers

    def restarted(self, peer: int) -> None:
        """Note that a peer lost its state: it has received and sent no reports."""
        self.near[peer] = np.arange(len(self.near)) != peer
        self._informed[peer] = np.arange(len(self.near)) != self._robot
        self._settled = False


class BroadcastCursors:
    """Offsets at which each robot's next broadcast of its own log begins, as far as that is known without a header.

    A robot that was in range of the last broadcast knows where the next one begins, so the header (`From`) is left out.
    `known`: all logs begin now; else no offset is known yet. On a medium that is not `reliable`, no peer can know.
    """

    def __init__(self, robots: int, *, known: bool, reliable: bool) -> None:
        self._reliable = reliable
        known = known and reliable
        self.own = 0
        """Offset after this robot's last broadcast of its own log."""
        self._aware = set(range(robots)) if known else set()
        """Robots that have been in range since then."""
        self._others: dict[int, int] = dict.fromkeys(range(robots), 0) if known else {}
        """Offset after each peer's last broadcast of its own log, if this robot received it."""

    def begin_step(self, in_range: list[int]) -> None:
        """Forget the cursors of robots out of range, which may have missed broadcasts."""
        self._aware.intersection_update(in_range)
        for peer in self._others.keys() - in_range:
            del self._others[peer]

    def known(self, first: int, peers: list[int]) -> bool:
        """Return whether all of `peers` know that this robot's next broadcast begins at offset `first`."""
        return first == self.own and self._aware.issuperset(peers)

    def sent(self, end: int, peers: list[int]) -> None:
        """Note that `peers` received this robot's own log up to offset `end`."""
        if self._reliable:
            self.own, self._aware = end, set(peers)

    def sent_earlier_incarnation(self) -> None:
        """Note a broadcast of a log of an earlier incarnation: receivers may take it for the current one."""
        self._aware.clear()

    def of(self, peer: int) -> int | None:
        """Return the offset of a peer's next broadcast of its own log; None if unknown."""
        return self._others.get(peer)

    def received(self, peer: int, end: int) -> None:
        """Note that a peer's broadcast of its own log ended at offset `end`."""
        if self._reliable:
            self._others[peer] = end

    def missed(self, peer: int) -> None:
        """Note that a broadcast of a peer could not be read."""
        self._others.pop(peer, None)

    def restarted(self, peer: int) -> None:
        """Note that a peer began a new log and knows no cursors."""
        self.missed(peer)
        self._aware.discard(peer)
