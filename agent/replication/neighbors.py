"""Gossip's tables of the robots in range: meetings, links, and where each robot's next broadcast begins."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

import numpy as np

from agent.replication.peers import Mask

GREETING = 1
"""Steps after a peer's arrival for which this robot waits for its report."""

Event = Literal["arrived", "reported", "timed out", "informed", "restarted", "left"]

TRANSITIONS: dict[Event, tuple[bool | None, bool | None]] = {
    "arrived": (True, True),
    "reported": (None, False),
    "timed out": (None, False),
    "informed": (False, None),
    "restarted": (True, None),
    "left": (False, False),
}
"""By event of a meeting: whether this robot owes the peer reports then, and whether it awaits one; None: as before.
*Informed*: the owed reports were on the air. *Restarted*: the peer lost its state."""


class Meetings:
    """The reports that this robot and robots that came into its range must exchange, by `TRANSITIONS`.

    Until a newcomer has reported, or `GREETING` steps have passed, this robot does not send it old entries: it may hold
    them already. `settled`: all start at the same time with empty logs; else everyone in range must report first.
    """

    def __init__(self, robots: int, *, settled: bool) -> None:
        self._arrived: dict[int, int] = dict.fromkeys(range(robots), 0) if settled else {}
        """The step in which each robot in range came there."""
        self.owed: set[int] = set()
        """Peers to which this robot owes reports."""
        self._awaited: set[int] = set()
        """Peers whose report it waits for."""

    def on(self, event: Event, *peers: int) -> None:
        """Follow the transition table, for all of `peers`."""
        for those, fact in zip((self.owed, self._awaited), TRANSITIONS[event], strict=True):
            if fact is not None:
                (those.update if fact else those.difference_update)(peers)

    def begin_step(self, step: int, in_range: Iterable[int]) -> None:
        """Note which peers have left the range and which have come; after `GREETING` steps, await no report."""
        here = set(in_range)
        self.on("left", *self._arrived.keys() - here)
        self.on("arrived", *here - self._arrived.keys())
        self._arrived = {peer: self._arrived.get(peer, step) for peer in here}
        self.on("timed out", *[peer for peer in self._awaited if step > self._arrived[peer] + GREETING])

    def known(self, in_range: Iterable[int]) -> list[int]:
        """Return the peers in range whose report is not awaited."""
        return [peer for peer in in_range if peer not in self._awaited]


class Links:
    """Which robots are in range of each other, and so received a broadcast.

    Each robot reports arrivals and departures in its own range (`Near`, `Gone`) until all peers in range have received
    that; where frames may be lost, it repeats the reports in turn. Until a robot reports otherwise, it
    counts as in range of all.
    """

    def __init__(self, robot: int, robots: int) -> None:
        self._robot = robot
        self.in_range: list[int] = []
        """The robots in this robot's range in this step."""
        self.have_parted = False
        """Whether any robot has ever been out of this robot's range; where frames may be lost, or out of a peer's."""
        self.near: Mask = np.ones((robots, robots), np.bool_)
        """``near[robot, other]``: whether `other` is in a robot's range, as is the robot itself, so it knows what the
        robot broadcasts; as to peers, by their reports."""
        self.near[robot] = np.arange(robots) == robot
        self._informed: Mask = np.ones((robots, robots), np.bool_)
        """``_informed[peer, other]``: whether `other` is in this robot's range, by the reports that a peer received."""
        self.news: list[tuple[int, bool]] = []
        """The robots of which a peer in range has an outdated report, and whether each is in this robot's range."""

    def begin_step(self, in_range: list[int]) -> None:
        """Note which robots are in range."""
        self.have_parted |= len(in_range) < len(self.near) - 1
        if in_range != self.in_range:
            self.in_range = in_range
            self.near[self._robot] = False
            self.near[self._robot, [self._robot, *in_range]] = True
            self._compare()

    def inform(self, other: int, here: bool) -> None:
        """Note that the peers in range received this robot's report about another robot."""
        self._informed[self.in_range, other] = here
        self._compare()

    def repeat(self, other: int) -> None:
        """Report again whether another robot is in range: peers may have missed that."""
        if other != self._robot:
            self._informed[self.in_range, other] = not self.near[self._robot, other]
            self._compare()

    def restarted(self, peer: int) -> None:
        """Note that a peer lost its state: it has received and sent no reports."""
        self.near[peer] = self._informed[peer] = True
        self._compare()

    def _compare(self) -> None:
        """Compare the reports that the peers in range received with this robot's range."""
        here = self.near[self._robot]
        outdated = (self._informed[self.in_range] != here).any(axis=0).nonzero()[0].tolist()
        self.news = [(other, bool(here[other])) for other in outdated]


class BroadcastCursors:
    """Offsets at which each robot's next broadcast of its own log begins, as far as that is known without a header.

    A robot that was in range of the last broadcast knows where the next one begins, so the header (`From`) is left out.
    `known`: all logs begin now; else no offset is known yet. On a medium that is not `reliable`, no peer can know.
    """

    def __init__(self, robots: int, *, known: bool, reliable: bool) -> None:
        self._reliable = reliable
        aware = range(robots) if known and reliable else ()
        self.own = 0
        """Offset after this robot's last broadcast of its own log."""
        self._aware = set(aware)
        """Robots that have been in range since then."""
        self.others = dict.fromkeys(aware, 0)
        """Offset after each peer's last broadcast of its own log, if this robot received it."""

    def begin_step(self, in_range: list[int]) -> None:
        """Forget the cursors of robots out of range, which may have missed broadcasts."""
        for peer in (self._aware | self.others.keys()).difference(in_range):
            self.forget(peer)

    def known(self, first: int, peers: list[int]) -> bool:
        """Return whether all of `peers` know that this robot's next broadcast begins at offset `first`."""
        return first == self.own and self._aware.issuperset(peers)

    def sent(self, end: int, peers: list[int]) -> None:
        """Note that `peers` received this robot's own log up to offset `end`."""
        if self._reliable:
            self.own, self._aware = end, set(peers)

    def received(self, peer: int, end: int) -> None:
        """Note that a peer's broadcast of its own log ended at offset `end`."""
        if self._reliable:
            self.others[peer] = end

    def forget(self, peer: int) -> None:
        """Note that a peer restarted or left the range, so that it and this robot do not know each other's cursors."""
        self.others.pop(peer, None)
        self._aware.discard(peer)
