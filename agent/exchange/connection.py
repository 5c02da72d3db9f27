"""One connection of a session, as one of its two ends sees it (section 5.1.2, Algorithm 8).

States and events (`TRANSITIONS`); an answer to an offer that was not made is an error:

    side      state      event                          next state   action
    offerer   idle       medium opens, there is news    offered      say offer(map, block)
    offerer   offered    answer, index below my own     sending      say data from that index on
    offerer   offered    answer, index not below        refused      say nothing
    offerer   offered    decline                        refused      say nothing
    receiver  idle       offer, first of its map        taking       say answer(index)
    receiver  idle       offer, another of that map     declining    say decline
    receiver  idle       offer of the receiver's map    declining    say decline
    receiver  idle       offer of one who is distrusted declining    say decline

With the outcome of the exchange all connections end: the offerer moves its table by what was carried, the
receiver appends the data that came to its log.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class State(StrEnum):
    """Where a connection stands."""

    __hash__ = str.__hash__  # the one of enumerations is not compiled

    IDLE = "idle"
    OFFERED = "offered"
    SENDING = "sending"
    REFUSED = "refused"
    TAKING = "taking"
    DECLINING = "declining"


class Event(StrEnum):
    """What can happen to a connection."""

    __hash__ = str.__hash__

    NEWS = "the medium opens and there is news"
    BEHIND = "the answer's index is below one's own"
    LEVEL = "the answer's index is not below one's own, or the peer does not want what it was sent"
    DECLINED = "the offer is declined"
    FIRST_OFFER = "the first offer of a map in this exchange"
    UNWANTED_OFFER = (
        "an offer of a map that is being taken, of the receiver's own, or of one who is distrusted"
    )


TRANSITIONS: dict[tuple[State, Event], State] = {
    (State.IDLE, Event.NEWS): State.OFFERED,
    (State.OFFERED, Event.BEHIND): State.SENDING,
    (State.OFFERED, Event.LEVEL): State.REFUSED,
    (State.OFFERED, Event.DECLINED): State.REFUSED,
    (State.IDLE, Event.FIRST_OFFER): State.TAKING,
    (State.IDLE, Event.UNWANTED_OFFER): State.DECLINING,
}


@dataclass(slots=True)
class Connection:
    """One connection as one of its two ends sees it.

    Attributes
    ----------
    peer, map : int
        The other end, and whose map it is about.
    state : State
    index : int
        As offerer: how far the peer is, as it said; before that, as one believes.
    """

    peer: int
    map: int
    state: State = State.IDLE
    index: int = 0

    def on(self, event: Event) -> State:
        """Move on by the table."""
        self.state = TRANSITIONS[self.state, event]
        return self.state
