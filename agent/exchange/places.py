"""Where the broadcasts of a robot's own log go on, which need not be said to who has heard the last one.

Who was in range then knows where the next broadcast begins, and so does who has heard it. Nobody does who has been out
of range since, or for whom a robot has begun anew.
"""

from __future__ import annotations

from collections.abc import Collection


class Places:
    """What one robot knows of these places, and what others know of its own.

    Parameters
    ----------
    robot : int
        One's own number.
    robots : int
    begun : bool
        Whether all logs begin now; else nobody knows anything yet.
    """

    def __init__(self, robot: int, robots: int, *, begun: bool) -> None:
        self._own = 0
        """Where the last broadcast of one's own log ended."""
        self._know = set(range(robots)) - {robot} if begun else set()
        """Who has been in range since then."""
        self._others: list[int | None] = [0 if begun else None] * robots
        """Where the last broadcast of each teammate's own log ended, if that was heard."""

    def in_range(self, peers: Collection[int]) -> None:
        """Only these are in range now."""
        self._know.intersection_update(peers)
        self._others = [place if peer in peers else None for peer, place in enumerate(self._others)]

    def known(self, first: int, peers: Collection[int]) -> bool:
        """Whether all of `peers` know that a broadcast of one's own log goes on at unit `first`."""
        return first == self._own and self._know.issuperset(peers)

    def said(self, end: int, peers: Collection[int]) -> None:
        """What one said of one's own log ended before unit `end`, and `peers` have heard it."""
        self._own, self._know = end, set(peers)

    def said_of_another_life(self) -> None:
        """One said some of a life that is over: who has not heard of this one takes that for the log that goes on."""
        self._know.clear()

    def of(self, peer: int) -> int | None:
        """Return where a peer's own log goes on; None: that is not known."""
        return self._others[peer]

    def heard(self, peer: int, end: int) -> None:
        """What a peer said of its own log ended before unit `end`."""
        self._others[peer] = end

    def begins_anew(self, peer: int) -> None:
        """A peer has begun a new log, and knows nothing any more."""
        self._others[peer] = None
        self._know.discard(peer)


class NoPlaces(Places):
    """Where a broadcast may have been missed without a word: nobody knows where one goes on, unless it says so."""

    def __init__(self, robot: int, robots: int) -> None:
        super().__init__(robot, robots, begun=False)

    def said(self, end: int, peers: Collection[int]) -> None:
        """Nobody knows."""

    def heard(self, peer: int, end: int) -> None:
        """Nobody knows."""
