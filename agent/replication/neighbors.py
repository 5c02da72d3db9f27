"""The radio range of each robot, as the robots report it (`Near`, `Gone`).

A robot must know which others received a broadcast. So each one reports arrivals and departures in its own range until
all peers in range have received that. Until a robot reports otherwise, it counts as in range of all.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from agent.replication.peers import Mask


class Neighbors:
    """Which robots are in range of each other, as far as one robot knows.

    Parameters
    ----------
    robot : int
        This robot's number.
    robots : int
    """

    def __init__(self, robot: int, robots: int) -> None:
        self._robot = robot
        self._near: Mask = ~np.eye(robots, dtype=np.bool_)
        """``_near[peer, other]``: whether `other` is in range of a peer, by the peer's reports."""
        self._informed: Mask = np.arange(robots) != np.full((robots, 1), robot)
        """``_informed[peer, other]``: whether `other` is in this robot's range, by the reports that a peer received."""

    def news(self, in_range: list[int]) -> list[tuple[int, bool]]:
        """Return the robots of which a peer in range has an outdated report, and whether each is in range now."""
        here = np.zeros(len(self._near), np.bool_)
        here[in_range] = True
        outdated = self._informed[in_range] ^ here
        outdated[range(len(in_range)), in_range] = False
        return [(other, bool(here[other])) for other in np.flatnonzero(outdated.any(axis=0)).tolist()]

    def inform(self, peers: list[int], other: int, here: bool) -> None:
        """Note that peers received this robot's report about another robot."""
        self._informed[peers, other] = here

    def reported(self, peer: int, other: int, here: bool) -> None:
        """Note a peer's report about another robot."""
        self._near[peer, other] = here

    def are_near(self, peer: int, other: int) -> bool:
        """Return whether another robot is in range of a peer, by the peer's reports."""
        return bool(self._near[peer, other])

    def receivers(self, peer: int) -> Mask:
        """Return the mask of all robots but this one that receive a peer's broadcasts."""
        receivers: Mask = self._near[peer].copy()
        receivers[self._robot] = False
        return receivers

    def restarted(self, peer: int) -> None:
        """Note that a peer lost its state: it has received and sent no reports."""
        self._near[peer] = np.arange(len(self._near)) != peer
        self._informed[peer] = np.arange(len(self._near)) != self._robot


class BroadcastCursors:
    """Offsets at which each robot's next broadcast of its own log begins, as far as that is known without a header.

    A robot that received the last broadcast, or was in range then, knows where the next one begins, so the header
    (`From`) is left out. On a medium that loses frames nobody can know.

    Parameters
    ----------
    robot : int
        This robot's number.
    robots : int
    known : bool
        Whether all logs begin now; else no offset is known yet.
    reliable : bool
        Whether all robots in range receive a broadcast.
    """

    def __init__(self, robot: int, robots: int, *, known: bool, reliable: bool) -> None:
        self._reliable = reliable
        known = known and reliable
        self._own = 0
        """Offset after this robot's last broadcast of its own log."""
        self._aware = set(range(robots)) - {robot} if known else set()
        """Robots that have been in range since then."""
        self._others: list[int | None] = [0 if known else None] * robots
        """Offset after each peer's last broadcast of its own log, if this robot received it."""

    def begin_step(self, in_range: Iterable[int]) -> None:
        """Forget what robots out of range may have missed."""
        peers = set(in_range)
        self._aware &= peers
        self._others = [cursor if peer in peers else None for peer, cursor in enumerate(self._others)]

    def known(self, first: int, peers: Iterable[int]) -> bool:
        """Return whether all of `peers` know that this robot's next broadcast begins at offset `first`."""
        return first == self._own and self._aware.issuperset(peers)

    def sent(self, end: int, peers: Iterable[int]) -> None:
        """Note that `peers` received this robot's own log up to offset `end`."""
        if self._reliable:
            self._own, self._aware = end, set(peers)

    def sent_earlier_incarnation(self) -> None:
        """Note a broadcast of a log of an earlier incarnation: receivers may take it for the current one."""
        self._aware.clear()

    def of(self, peer: int) -> int | None:
        """Return the offset of a peer's next broadcast of its own log; None if unknown."""
        return self._others[peer]

    def received(self, peer: int, end: int) -> None:
        """Note that a peer's broadcast of its own log ended at offset `end`."""
        if self._reliable:
            self._others[peer] = end

    def restarted(self, peer: int) -> None:
        """Note that a peer began a new log and knows no cursors."""
        self._others[peer] = None
        self._aware.discard(peer)
