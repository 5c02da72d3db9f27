"""Gossip's table of the robots in range: links, meetings, and where each robot's next broadcast begins.

Robots that meet report the log lengths that the other may not know. Until a newcomer has reported, or `GREETING` steps
have passed, this robot does not send it old entries: it may hold them already.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Literal

import numpy as np

from agent.replication.peers import Mask

GREETING = 1
"""Steps after a peer's arrival for which this robot waits for its report."""

State = Literal["away", "meeting", "owing", "awaiting", "settled"]
Event = Literal["arrived", "reported", "timed out", "informed", "restarted", "left"]

TRANSITIONS: dict[tuple[State, Event], State] = {
    ("away", "arrived"): "meeting",
    ("away", "restarted"): "owing",
    ("meeting", "reported"): "owing",
    ("meeting", "timed out"): "owing",
    ("meeting", "informed"): "awaiting",
    ("owing", "informed"): "settled",
    ("owing", "arrived"): "meeting",
    ("awaiting", "reported"): "settled",
    ("awaiting", "timed out"): "settled",
    ("awaiting", "restarted"): "meeting",
    ("settled", "restarted"): "owing",
}
"""The states of a meeting with one peer. From every state "left" leads to "away"; other events change nothing.

Events: the peer comes into range (arrived), reports, restarts or leaves the range; this robot's reports were sent
(informed); the greeting times out.
"""

_AWAITING = ("meeting", "awaiting")
"""States in which this robot waits for the peer's report."""


class Meetings:
    """This robot's meetings with all peers.

    `settled`: all start at the same time with empty logs; else everyone in range must report first.
    """

    def __init__(self, robots: int, *, settled: bool) -> None:
        self._states: list[State] = ["settled" if settled else "away"] * robots
        self._in_range = set(range(robots)) if settled else set[int]()
        self._arrived: dict[int, int] = {}
        """The step in which each peer came into range last."""

    def on(self, peer: int, event: Event) -> None:
        """Follow the transition table."""
        state = self._states[peer]
        self._states[peer] = "away" if event == "left" else TRANSITIONS.get((state, event), state)

    def begin_step(self, step: int, in_range: Sequence[int]) -> None:
        """Note which peers have left the range and which have come, and time out greetings."""
        before, self._in_range = self._in_range, set(in_range)
        for peer, state in enumerate(self._states):
            if state != "away" and peer not in self._in_range:
                self.on(peer, "left")
        for peer in in_range:
            if peer not in before:
                self.on(peer, "arrived")
                self._arrived[peer] = step
            elif self._awaits_report(peer) and step > self._arrived[peer] + GREETING:
                self.on(peer, "timed out")

    def owed(self) -> list[int]:
        """Return the peers to which this robot owes reports, ascending."""
        return [peer for peer, state in enumerate(self._states) if state in ("meeting", "owing")]

    def known(self, in_range: Iterable[int]) -> list[int]:
        """Return the peers in range whose report is not awaited."""
        states = self._states
        return [peer for peer in in_range if states[peer] not in _AWAITING]

    def _awaits_report(self, peer: int) -> bool:
        return self._states[peer] in _AWAITING


class Neighbors:
    """Which robots are in range of each other, as they report it (`Near`, `Gone`).

    A robot must know which others received a broadcast. So each one reports arrivals and departures in its own range
    until all peers in range have received that. Until a robot reports otherwise, it counts as in range of all.
    """

    def __init__(self, robot: int, robots: int) -> None:
        self._robot = robot
        self.near: Mask = ~np.eye(robots, dtype=np.bool_)
        """``near[peer, other]``: whether `other` is in range of a peer, by the peer's reports."""
        self._informed: Mask = np.arange(robots) != np.full((robots, 1), robot)
        """``_informed[peer, other]``: whether `other` is in this robot's range, by the reports that a peer received.

        True for the peer itself: only peers in range are informed.
        """
        self._settled: list[int] | None = None
        """The peers in range of which none had an outdated report at the last call of `news`; None if any had."""

    def news(self, in_range: list[int]) -> list[tuple[int, bool]]:
        """Return the robots of which a peer in range has an outdated report, and whether each is in range now."""
        if in_range == self._settled:
            return []
        here = np.zeros(len(self.near), np.bool_)
        here[in_range] = True
        outdated = np.logical_or.reduce(self._informed[in_range] != here).nonzero()[0].tolist()
        self._settled = None if outdated else in_range
        return [(other, bool(here[other])) for other in outdated]

    def inform(self, peers: list[int], other: int, here: bool) -> None:
        """Note that peers received this robot's report about another robot."""
        self._informed[peers, other] = here
        self._settled = None

    def restarted(self, peer: int) -> None:
        """Note that a peer lost its state: it has received and sent no reports."""
        self.near[peer] = np.arange(len(self.near)) != peer
        self._informed[peer] = np.arange(len(self.near)) != self._robot
        self._settled = None


class BroadcastCursors:
    """Offsets at which each robot's next broadcast of its own log begins, as far as that is known without a header.

    A robot that received the last broadcast, or was in range then, knows where the next one begins, so the header
    (`From`) is left out. `known`: all logs begin now; else no offset is known yet. On a medium that loses frames, that
    is not `reliable`, no peer can know.
    """

    def __init__(self, robot: int, robots: int, *, known: bool, reliable: bool) -> None:
        self._reliable = reliable
        known = known and reliable
        self._own = 0
        """Offset after this robot's last broadcast of its own log."""
        self._aware = set(range(robots)) - {robot} if known else set()
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
        return first == self._own and self._aware.issuperset(peers)

    def sent(self, end: int, peers: list[int]) -> None:
        """Note that `peers` received this robot's own log up to offset `end`."""
        if self._reliable:
            self._own, self._aware = end, set(peers)

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
