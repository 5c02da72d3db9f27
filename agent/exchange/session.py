"""The session: logs of all robots' maps, passed on transitively over the medium's rounds (thesis, section 5.1.2).

Every robot holds a log of each map it has heard of, its own included, and a table of how far each log has
reached each teammate. It offers what is news to a teammate; the teammate answers how far it is; the rest is
sent. What the relay did not put on the air did not happen: the table and the logs move when the outcome is
told, and by nothing else.

States and events of one connection; who is in a state that does not list an event ignores it:

    side      state      event                          next state   action
    offerer   idle       medium opens, there is news    offered      say offer(map, block)
    offerer   offered    answer, index below my own     sending      say data from that index on
    offerer   offered    answer, index not below        refused      say nothing
    offerer   offered    decline                        refused      say nothing
    offerer   (any)      outcome                        idle         move the table by what was carried
    receiver  idle       offer, first of its map        taking       say answer(index)
    receiver  idle       offer, another of that map     declining    say decline
    receiver  taking     data                           taking       append to the log
    receiver  (any)      outcome                        idle         nothing is kept but the log
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from agent.exchange.log import Log
from protocol import packets
from protocol.errors import ProtocolError
from protocol.messages import Outcome
from protocol.packets import BLOCKS, INDEX_WINDOW

MAX_WAIT = 64
"""Exchanges that an offer is put off at most."""

POLICIES = ("backoff", "thesis")
"""When maps are offered. ``thesis``: in every exchange all maps, to all for whom they are news. ``backoff``: at
most one map to each teammate, the robot's own if it is news, else, after a step's first exchange, the one with
most news; after a refusal twice as long a wait."""


class State(Enum):
    """Where a connection stands."""

    IDLE = "idle"
    OFFERED = "offered"
    SENDING = "sending"
    REFUSED = "refused"
    TAKING = "taking"
    DECLINING = "declining"


class Event(Enum):
    """What can happen to a connection."""

    NEWS = "the medium opens and there is news"
    BEHIND = "the answer's index is below one's own"
    LEVEL = "the answer's index is not below one's own"
    DECLINED = "the offer is declined"
    FIRST_OFFER = "the first offer of a map in this exchange"
    OTHER_OFFER = "another offer of a map that is being taken"


TRANSITIONS: dict[tuple[State, Event], State] = {
    (State.IDLE, Event.NEWS): State.OFFERED,
    (State.OFFERED, Event.BEHIND): State.SENDING,
    (State.OFFERED, Event.LEVEL): State.REFUSED,
    (State.OFFERED, Event.DECLINED): State.REFUSED,
    (State.IDLE, Event.FIRST_OFFER): State.TAKING,
    (State.IDLE, Event.OTHER_OFFER): State.DECLINING,
}


@dataclass
class Connection:
    """One connection as one of its two ends sees it.

    Attributes
    ----------
    peer, map : int
        The other end, and whose map it is about.
    state : State
    index : int
        As offerer: how far the peer said to be.
    """

    peer: int
    map: int
    state: State = State.IDLE
    index: int = 0

    def on(self, event: Event) -> State:
        """Move on by the table."""
        self.state = TRANSITIONS[self.state, event]
        return self.state


@dataclass
class _Backoff:
    """How long offers of one map to one peer are put off."""

    wait: int = 1
    due: int = 0

    def refused(self, now: int) -> None:
        self.due = now + self.wait
        self.wait = min(2 * self.wait, MAX_WAIT)

    def accepted(self) -> None:
        self.wait = 1


class Session:
    """One robot's end of all connections."""

    def __init__(self, robot: int, robots: int, policy: str = "backoff") -> None:
        if policy not in POLICIES:
            raise ValueError(f"no offer policy is called {policy!r}; there are: {', '.join(POLICIES)}")
        self.logs = [Log() for _ in range(robots)]
        """What is held of every robot's map."""
        self.known = [[0] * robots for _ in range(robots)]
        """``known[peer][map]``: up to which unit the map has reached the peer, as far as one can know."""
        self._robot = robot
        self._policy = policy
        self._now = 0
        self._backoff: dict[tuple[int, int], _Backoff] = {}
        self._room: int | None = None
        self._peers: list[int] = []
        self._said: list[Connection] = []
        self._offered: dict[int, Connection] = {}
        self._taken: dict[int, Connection] = {}

    def record(self, units: list[bytes]) -> None:
        """Append to the log of one's own map."""
        self.logs[self._robot].append(units)

    def offers(self, exchange: int, peers: list[int], room: int | None) -> list[tuple[int, int, bytes]]:
        """Open an exchange: return offers as (peer, map, frame).

        `room` is what is left of the step's budget in bytes, None for no limit.
        """
        self._now += 1
        self._room = room
        self._peers = peers
        self._offered.clear()
        self._taken.clear()
        self._said = [
            Connection(peer, about) for peer in peers for about in self._worth_offering(exchange, peer)
        ]
        frames = []
        for connection in self._said:
            connection.on(Event.NEWS)
            block = self.known[connection.peer][connection.map] // INDEX_WINDOW % BLOCKS
            offer = packets.Offer(connection.map, block)
            frames.append((connection.peer, connection.map, packets.encode([offer])))
        return frames

    def answers(self, heard: list[tuple[int, int, bytes]]) -> list[tuple[int, int, bytes]]:
        """Answer offers, given and returned as (connection number, peer, frame).

        Raises
        ------
        ProtocolError
            A frame is no offer.
        """
        frames = []
        for number, peer, payload in heard:
            offer = _only_offer(payload)
            if offer.map >= len(self.logs):
                raise ProtocolError(offer.name, 0, f"map {offer.map} of {len(self.logs)} robots")
            connection = Connection(peer, offer.map)
            self._taken[number] = connection
            busy = any(
                other.map == offer.map and other.state is State.TAKING for other in self._taken.values()
            )
            if connection.on(Event.OTHER_OFFER if busy else Event.FIRST_OFFER) is State.TAKING:
                said = _answer(len(self.logs[offer.map]), offer.block)
            else:
                said = [packets.Decline()]
            frames.append((number, peer, packets.encode(said)))
        return frames

    def data(self, heard: list[tuple[int, int, int, bytes]]) -> list[tuple[int, int, bytes]]:
        """Send what was asked for, given answers as (connection number, peer, map, frame).

        Returns data as (connection number, peer, frame).

        Raises
        ------
        ProtocolError
            A frame is no answer, or not to an offer of one's own.
        """
        frames = []
        said = {(connection.peer, connection.map): connection for connection in self._said}
        for number, peer, about, payload in heard:
            connection = said.get((peer, about))
            if connection is None or connection.state is not State.OFFERED:
                raise ProtocolError("conn", 0, f"robot {peer} answers an offer that was not made")
            self._offered[number] = connection
            if connection.on(self._read_answer(connection, payload)) is State.SENDING:
                units = self.logs[connection.map].since(connection.index, self._room)
                if units:
                    frames.append((number, peer, b"".join(units)))
        return frames

    def outcome(
        self, outcome: Outcome, heard: list[tuple[int, bytes]]
    ) -> list[tuple[int, int, list[bytes]]]:
        """Move the table by what was carried; return the news that came, as (peer, map, units).

        `heard` has the data that reached this robot as (peer, frame), in the order of ``outcome.heard``. The
        caller appends the units with `accept` once it has made sense of them.
        """
        for number, answered, sent in zip(
            outcome.connections, outcome.answers, outcome.data, strict=True
        ):
            connection = self._offered.get(number)
            if connection is not None and answered:
                self._settle(connection, sent)
        news = []
        for number, (peer, payload) in zip(outcome.heard, heard, strict=True):
            connection = self._taken.get(number)
            if connection is not None and connection.state is State.TAKING:
                news.append((peer, connection.map, packets.split(payload)))
        return news

    def accept(self, peer: int, about: int, units: list[bytes]) -> None:
        """Append units of a map that a peer sent; the peer holds them too."""
        self.logs[about].append(units)
        self.known[peer][about] = max(self.known[peer][about], len(self.logs[about]))

    def delivered(self) -> bool:
        """Whether teammates were in range when the medium last opened, and all hold one's own log."""
        return bool(self._peers) and all(
            self.known[peer][self._robot] == len(self.logs[self._robot]) for peer in self._peers
        )

    def undelivered(self) -> int:
        """Units of one's own map that have not reached a teammate yet, all teammates counted."""
        held = len(self.logs[self._robot])
        return sum(
            held - known[self._robot] for peer, known in enumerate(self.known) if peer != self._robot
        )

    def forget(self) -> None:
        """Drop what all teammates hold."""
        for about, log in enumerate(self.logs):
            holders = [self.known[peer][about] for peer in range(len(self.logs)) if peer != self._robot]
            if holders:
                log.forget(min(holders))

    def _worth_offering(self, exchange: int, peer: int) -> list[int]:
        """Maps to offer a peer now, as the policy has it."""
        others = [about for about in range(len(self.logs)) if about not in (self._robot, peer)]
        news = [about for about in (self._robot, *others) if self._news_of(peer, about) > 0]
        if self._policy == "thesis":
            return news
        due = [about for about in news if self._now >= self._put_off(peer, about).due]
        if self._robot in due:
            return [self._robot]
        if exchange == 0 or not due:
            return []
        return [max(due, key=lambda about: self._news_of(peer, about))]

    def _news_of(self, peer: int, about: int) -> int:
        """Units of a map that have not reached a peer, as far as one can know."""
        return len(self.logs[about]) - self.known[peer][about]

    def _put_off(self, peer: int, about: int) -> _Backoff:
        return self._backoff.setdefault((peer, about), _Backoff())

    def _read_answer(self, connection: Connection, payload: bytes) -> Event:
        """Resolve the index of an answer: the first that fits at or above what the table says."""
        said = packets.handshake(payload)
        if len(said) == 1 and isinstance(said[0], packets.Decline):
            return Event.DECLINED
        known = self.known[connection.peer][connection.map]
        block, answer = (said[0], said[1]) if len(said) == 2 else (None, said[0])
        if not isinstance(answer, packets.Answer) or not isinstance(block, packets.Block | None):
            raise ProtocolError("conn", 0, "expected an answer, a block and an answer, or a decline")
        window = BLOCKS * INDEX_WINDOW
        wanted = (block.block if block else known // INDEX_WINDOW % BLOCKS) * INDEX_WINDOW + answer.index
        connection.index = known + (wanted - known) % window
        log = self.logs[connection.map]
        return Event.BEHIND if log.oldest <= connection.index < len(log) else Event.LEVEL

    def _settle(self, connection: Connection, sent: int) -> None:
        """An answer was carried, and so many bytes of data after it."""
        peer, about = connection.peer, connection.map
        backoff = self._put_off(peer, about)
        if connection.state is State.REFUSED:
            backoff.refused(self._now)
            if connection.index:
                self.known[peer][about] = max(
                    self.known[peer][about], min(connection.index, len(self.logs[about]))
                )
        elif connection.state is State.SENDING:
            backoff.accepted()
            units = 0
            for unit in self.logs[about].since(connection.index, sent):
                sent -= len(unit)
                units += 1
            self.known[peer][about] = max(self.known[peer][about], connection.index + units)


def _only_offer(payload: bytes) -> packets.Offer:
    said = packets.handshake(payload)
    if len(said) != 1 or not isinstance(said[0], packets.Offer):
        raise ProtocolError("conn", 0, "expected one offer")
    return said[0]


def _answer(held: int, assumed_block: int) -> list[packets.Packet]:
    """Say how many units one holds; where the offer assumed another block, name it first."""
    block = held // INDEX_WINDOW % BLOCKS
    answer = packets.Answer(held % INDEX_WINDOW)
    return [answer] if block == assumed_block else [packets.Block(block), answer]
