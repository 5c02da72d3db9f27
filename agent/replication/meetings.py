"""Meetings of robots that gossip: after coming into range, each reports the log lengths that the other may not know.

Until a newcomer has reported, or `GREETING` steps have passed, this robot does not send it old entries: it may hold
them already. `TRANSITIONS` is the table that the code runs by; an event without an entry leaves the state as it is:

    state      event                                     next state
    away       the peer comes into range                 meeting
    away       the peer restarts                         owing
    meeting    the peer reports                          owing
    meeting    the greeting times out                    owing
    meeting    this robot's reports were sent            awaiting
    owing      this robot's reports were sent            settled
    owing      the peer comes into range                 meeting
    awaiting   the peer reports                          settled
    awaiting   the greeting times out                    settled
    awaiting   the peer restarts                         meeting
    settled    the peer restarts                         owing
    any        the peer leaves the range                 away
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from enum import StrEnum

GREETING = 1
"""Steps after a peer's arrival for which this robot waits for its report."""


class State(StrEnum):
    """State of a meeting with one peer."""

    __hash__ = str.__hash__

    AWAY = "away"
    MEETING = "meeting"
    OWING = "owing"
    AWAITING = "awaiting"
    SETTLED = "settled"


class Event(StrEnum):
    """Event that a meeting reacts to."""

    __hash__ = str.__hash__

    ARRIVED = "the peer comes into range"
    REPORTED = "the peer reports"
    TIMED_OUT = "the greeting times out"
    INFORMED = "this robot's reports were sent"
    RESTARTED = "the peer restarts"
    LEFT = "the peer leaves the range"


TRANSITIONS: dict[tuple[State, Event], State] = {
    (State.AWAY, Event.ARRIVED): State.MEETING,
    (State.AWAY, Event.RESTARTED): State.OWING,
    (State.MEETING, Event.REPORTED): State.OWING,
    (State.MEETING, Event.TIMED_OUT): State.OWING,
    (State.MEETING, Event.INFORMED): State.AWAITING,
    (State.OWING, Event.INFORMED): State.SETTLED,
    (State.OWING, Event.ARRIVED): State.MEETING,
    (State.AWAITING, Event.REPORTED): State.SETTLED,
    (State.AWAITING, Event.TIMED_OUT): State.SETTLED,
    (State.AWAITING, Event.RESTARTED): State.MEETING,
    (State.SETTLED, Event.RESTARTED): State.OWING,
    **{(state, Event.LEFT): State.AWAY for state in State},
}

_OWES_REPORTS = frozenset((State.MEETING, State.OWING))
_AWAITS_REPORT = frozenset((State.MEETING, State.AWAITING))


class Meetings:
    """This robot's meetings with all peers.

    Parameters
    ----------
    robots : int
    settled : bool
        Whether all start at the same time with empty logs; else everyone in range must report first.
    """

    def __init__(self, robots: int, *, settled: bool) -> None:
        self._states = [State.SETTLED if settled else State.AWAY] * robots
        self._in_range = set(range(robots)) if settled else set[int]()
        self._arrived: dict[int, int] = {}
        """The step in which each peer came into range last."""

    def on(self, peer: int, event: Event) -> None:
        """Follow the transition table."""
        self._states[peer] = TRANSITIONS.get((self._states[peer], event), self._states[peer])

    def begin_step(self, step: int, in_range: Sequence[int]) -> None:
        """Note which peers have left the range and which have come, and time out greetings."""
        before, self._in_range = self._in_range, set(in_range)
        for peer in range(len(self._states)):
            if peer not in self._in_range:
                self.on(peer, Event.LEFT)
        for peer in in_range:
            if peer not in before:
                self.on(peer, Event.ARRIVED)
                self._arrived[peer] = step
            elif self._states[peer] in _AWAITS_REPORT and step > self._arrived[peer] + GREETING:
                self.on(peer, Event.TIMED_OUT)

    def owed(self) -> list[int]:
        """Return the peers to which this robot owes reports, ascending."""
        return [peer for peer, state in enumerate(self._states) if state in _OWES_REPORTS]

    def known(self, in_range: Iterable[int]) -> list[int]:
        """Return the peers in range whose report is not awaited."""
        return [peer for peer in in_range if self._states[peer] not in _AWAITS_REPORT]
