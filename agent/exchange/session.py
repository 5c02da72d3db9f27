"""The session: logs of all robots' maps, passed on over the medium's rounds (section 5.1.2, Algorithm 8).

Every robot holds a log of each map it has heard of, its own included, and a table of how far each log has
reached each teammate. It offers what is news to a teammate; the teammate answers how far it is; the rest is
sent. What the relay did not put on the air did not happen: the table and the logs move when the outcome is
told, and by nothing else.

Both ends of a connection go through the states of `agent.exchange.connection`; `agent.exchange.offer_policy` says which
to open. A peer that says to hold less than it was sent does not want it: it counts as level.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from agent.exchange.connection import Connection, Event, State
from agent.exchange.handshake import (
    DECLINE,
    LEAST_HANDSHAKE,
    answer,
    block_of,
    offer,
    read_answer,
    read_offer,
)
from agent.exchange.log import Log
from agent.exchange.offer_policy import CROWD, POLICIES, all_news, choose_offers
from agent.exchange.outcome import Outcome
from protocol.errors import ProtocolError
from protocol.kernels import kernel
from protocol.messages import NO_REPLIES, AnswerReply, OfferReply, Replies

MAX_WAIT = 64
"""Exchanges that an offer is put off at most."""

PATIENCE = 4
"""Who has refused one's own map so often that offers wait for more exchanges than these is not waited for."""

MOST_BEFOREHAND = 1 << 16
"""Bytes of data that are handed over beforehand, before it is known who lacks them."""

Table = NDArray[np.int64]


class Session:
    """One robot's end of all connections."""

    def __init__(
        self, robot: int, robots: int, policy: str = "backoff", *, incarnations: int = 1, incarnation: int = 0
    ) -> None:
        if policy not in POLICIES:
            raise ValueError(f"no offer policy is called {policy!r}; there are: {', '.join(POLICIES)}")
        self.logs = [Log() for _ in range(robots * incarnations)]
        """What is held of every robot's map, of each of its lives (`agent.identity`)."""
        self.own = robot + robots * incarnation
        """The number of one's own map."""
        self.priority = 0
        """Offers wait for nothing: their order is drawn."""
        self.refused: set[tuple[int, int]] = set()
        """(peer, map): offers that are declined, for what came of them made no sense."""
        self._robot = robot
        self.forwards_state = True
        """Whether maps of others are offered as well as one's own."""
        self._robots = robots
        self._lives = incarnations
        self._policy = policy
        self._now = 0
        self._only_first = True
        self._next = robot + 1
        """The teammate whose turn it is, where not all are made offers."""
        self._room: int | None = None
        self._peers: list[int] = []
        self._said: dict[tuple[int, int], Connection] = {}
        self._offered: dict[int, Connection] = {}
        self._taken: dict[int, Connection] = {}
        self._being_taken: set[int] = set()
        self._heard = 0
        """Up to which unit one's own log has reached teammates in lives that are over."""
        self._own_maps = np.arange(robots)
        """The number of each robot's own map, in the life that it is in, as far as one has heard."""

    # Tables are made when the first map is to be offered: where none are exchanged there are none.

    @cached_property
    def known(self) -> Table:
        """``known[peer, map]``: up to which unit the map has reached the peer, as far as one can know."""
        return np.zeros((self._robots, len(self.logs)), np.int64)

    @cached_property
    def _wait(self) -> Table:
        """``_wait[peer, map]``: for how many exchanges offers of a map to a peer are put off if it refuses."""
        return np.ones((self._robots, len(self.logs)), np.int64)

    @cached_property
    def _due(self) -> Table:
        """``_due[peer, map]``: the exchange before which it is not offered again."""
        return np.zeros((self._robots, len(self.logs)), np.int64)

    def record(self, units: list[bytes]) -> None:
        """Append to the log of one's own map."""
        self.logs[self.own].append(units)

    def retract(self, count: int) -> bool:
        """Take the last `count` units of one's own log back, if nobody has heard any of them; say whether."""
        heard = max(self._heard, *self.known[:, self.own].tolist())
        return self.logs[self.own].retract(count, heard)

    def offers(self, round_number: int, peers: list[int], room: int | None) -> list[tuple[int, int, bytes]]:
        """Open an exchange: return offers as (peer, map, frame).

        `room` is what is left of the step's budget in bytes, None for no limit.
        """
        self._now += 1
        self._only_first = self._only_first and round_number == 0
        self._room = room
        self._peers = peers
        for of_last_exchange in (self._said, self._offered, self._taken, self._being_taken):
            of_last_exchange.clear()
        held = [len(log) for log in self.logs] if peers else []
        if not any(held):
            return []
        frames = []
        for peer, map_id in self._worth_offering(round_number, np.array(held, np.int64)):
            known = self.known.item(peer, map_id)
            connection = self._said[peer, map_id] = Connection(peer, map_id, index=known)
            connection.on(Event.NEWS)
            frames.append((peer, map_id, offer(map_id, known)))
        return frames

    def replies(self) -> Replies:
        """What one is going to say in this exchange if all is as it seems: to offers, and behind one's own.

        As `answers` and `data` will: who hands it over with the offers need not be asked for them. Data only of one's
        own map: of others' teammates mostly hold by now what one believes that they lack.
        """
        if not self._peers or self._policy != "backoff" or not any(self.logs):
            return NO_REPLIES
        refused = {map_id for _, map_id in self.refused}
        refused.update(range(self.own, len(self.logs), self._robots))
        held = [(map_id, len(log)) for map_id, log in enumerate(self.logs) if map_id not in refused]
        offers = [OfferReply(offer(map_id, units), answer(units, block_of(units))) for map_id, units in held]
        replies: list[tuple[bytes, bytes, int]] = []
        loads: dict[int, bytes] = {}
        for connection in self._said.values():
            map_id, known = connection.map, connection.index
            if map_id == self.own and known not in loads:
                loads[known] = self.logs[map_id].since(known, self._room)
            load = list(loads).index(known) if map_id == self.own else -1
            up_to_date = answer(len(self.logs[map_id]), block_of(known))
            replies.append((up_to_date, answer(known, block_of(known)), load))
        if sum(map(len, loads.values())) > MOST_BEFOREHAND:
            replies, loads = [(*each[:2], -1) for each in replies], {}
        return Replies(offers, DECLINE, [AnswerReply(*each) for each in replies], list(loads.values()))

    def answers(self, heard: list[tuple[int, int, bytes]]) -> list[tuple[int, int, bytes]]:
        """Answer offers, given and returned as (connection number, peer, frame).

        Raises
        ------
        ProtocolError
            A frame is no offer.
        """
        frames = []
        for number, peer, payload in heard:
            offered = read_offer(payload)
            if offered.map >= len(self.logs):
                raise ProtocolError(offered.name, 0, f"map {offered.map} of {len(self.logs)} robots")
            connection = Connection(peer, offered.map)
            self._taken[number] = connection
            unwanted = (
                (offered.map >= self.own and offered.map % self._robots == self._robot)
                or offered.map in self._being_taken
                or (peer, offered.map) in self.refused
            )
            if connection.on(Event.UNWANTED_OFFER if unwanted else Event.FIRST_OFFER) is State.TAKING:
                self._being_taken.add(offered.map)
                said = answer(len(self.logs[offered.map]), offered.block)
            else:
                said = DECLINE
            frames.append((number, peer, said))
        return frames

    def data(self, heard: list[tuple[int, int, int, bytes]]) -> list[tuple[int, int, bytes]]:
        """Send what was asked for, given answers as (connection number, peer, map, frame).

        Returns data as (connection number, peer, frame), in all no more than the medium had room for: connections
        go on the air by their numbers, so what lies beyond could not be carried.

        Raises
        ------
        ProtocolError
            A frame is no answer, or not to an offer of one's own.
        """
        frames = []
        room = self._room
        for number, peer, map_id, payload in heard:
            connection = self._said.get((peer, map_id))
            if connection is None or connection.state is not State.OFFERED:
                raise ProtocolError("conn", 0, f"robot {peer} answers an offer that was not made")
            self._offered[number] = connection
            if connection.on(self._read_answer(connection, payload)) is State.SENDING:
                frame = self.logs[map_id].since(connection.index, room)
                if frame:
                    frames.append((number, peer, frame))
                if room is not None:
                    room -= len(frame)
        return frames

    def outcome(self, outcome: Outcome, heard: list[tuple[int, bytes]]) -> list[tuple[int, int, bytes]]:
        """Move the table by what was carried; return the news that came, as (peer, map, frame).

        `heard` has the data that reached this robot as (peer, frame), in the order of ``outcome.heard``. The
        caller appends the units of a frame with `accept` once it has made sense of them.
        """
        for number, answered, sent in zip(outcome.connections, outcome.answers, outcome.data, strict=True):
            connection = self._offered.get(number)
            if connection is not None and answered:
                self._settle(connection, sent)
        if self._lives > 1:
            for number, offered in zip(outcome.connections, outcome.offers, strict=True):
                connection = self._taken.get(number)
                if connection is not None and offered:
                    self._recognise(connection.peer, connection.map)
        news = []
        for number, (peer, payload) in zip(outcome.heard, heard, strict=True):
            connection = self._taken.get(number)
            if connection is not None and connection.state is State.TAKING:
                news.append((peer, connection.map, payload))
        return news

    def accept(self, peer: int, map_id: int, frame: bytes, ends: Sequence[int]) -> None:
        """Append units of a map that a peer sent, given where in the frame they end; the peer holds them too."""
        self.logs[map_id].extend(frame, ends)
        self.known[peer, map_id] = max(self.known[peer, map_id], len(self.logs[map_id]))

    def delivered(self) -> bool:
        """Whether teammates were in range when the medium last opened, and all hold one's own log.

        But for those who refuse it again and again (`PATIENCE`): nobody can silence the others.
        """
        held = len(self.logs[self.own])
        if not self._peers or not held:
            return bool(self._peers)
        known, wait = self.known[:, self.own].tolist(), self._wait[:, self.own].tolist()
        return all(known[peer] == held or wait[peer] > PATIENCE for peer in self._peers)

    def undelivered(self) -> int:
        """Units of one's own map that have not reached a teammate yet, all teammates counted."""
        held = len(self.logs[self.own])
        if not held:
            return 0
        reached: list[int] = self.known[:, self.own].tolist()
        return held * (self._robots - 1) - sum(reached)

    def forget(self) -> None:
        """Drop what all teammates hold; where they may come back, and hold nothing then, that is nothing."""
        if self._lives > 1 or not any(self.logs):
            return
        reached = np.empty(self._robots, np.int64)
        reached_by_all(self.known, self._robot, reached)
        for log, before in zip(self.logs, reached.tolist(), strict=True):
            log.forget(before)

    def _worth_offering(self, round_number: int, held: Table) -> list[tuple[int, int]]:
        """Offers to make now, as (peer, map), as the policy has it; `held`: the length of each log."""
        if not self.forwards_state:
            held = np.where(np.arange(len(held)) == self.own, held, 0)
        peers = np.array(self._peers, np.int64)
        if self._policy == "thesis":
            return all_news(self.own, self._peers, self._own_maps, self.known, held)
        chosen = np.empty(len(peers), np.int64)
        rule = self._now, round_number, self._only_first
        choose_offers(self.known, self._due, held, peers, self._own_maps, self.own, *rule, chosen)
        offers = [
            (peer, map_id) for peer, map_id in zip(self._peers, chosen.tolist(), strict=True) if map_id >= 0
        ]
        around = len(self._peers) + 1
        if self._room is None or around <= CROWD:
            return offers
        return self._in_turn(offers, max(1, self._room // (LEAST_HANDSHAKE * around)))

    def _in_turn(self, offers: list[tuple[int, int]], most: int) -> list[tuple[int, int]]:
        """Of offers by ascending peer so many, of those whose turn it is."""
        if len(offers) > most:
            first = bisect_left(offers, (self._next,))
            offers = [*offers[first:], *offers[:first]][:most]
        if offers:
            self._next = offers[-1][0] + 1
        return offers

    def _recognise(self, peer: int, map_id: int) -> None:
        """Who offers the map of a new life of its own has begun anew, and holds nothing of what it was sent before."""
        if map_id % self._robots == peer and map_id > self._own_maps[peer]:
            self._own_maps[peer] = map_id
            self._heard = max(self._heard, int(self.known[peer, self.own]))
            self.known[peer] = self._due[peer] = 0
            self._wait[peer] = 1

    def _read_answer(self, connection: Connection, payload: bytes) -> Event:
        """Note how far the peer is, and compare it with what is held."""
        known, held = connection.index, len(self.logs[connection.map])
        index = read_answer(payload, block_of(known))
        if index is None:
            return Event.DECLINED
        connection.index = index if known <= index < held else held
        return Event.BEHIND if connection.index < held else Event.LEVEL

    def _settle(self, connection: Connection, sent: int) -> None:
        """An answer was carried, and so many bytes of data after it."""
        peer, map_id = connection.peer, connection.map
        reached = connection.index
        if connection.state is State.REFUSED:
            wait = int(self._wait[peer, map_id])
            self._due[peer, map_id], self._wait[peer, map_id] = self._now + wait, min(2 * wait, MAX_WAIT)
        elif connection.state is State.SENDING:
            self._wait[peer, map_id] = 1
            reached = self.logs[map_id].reached(reached, sent)
        self.known[peer, map_id] = max(self.known[peer, map_id], reached)


@kernel("void(int64[:,::1], int64, int64[::1])")
def reached_by_all(known: Table, robot: int, reached: Table) -> None:
    """Note of each map up to which unit all have it but the robot itself and the map's own robot."""
    robots = len(known)
    reached[:] = np.iinfo(np.int64).max
    for peer in range(robots):
        if peer == robot:
            continue
        for map_id in range(robots):
            if map_id != peer:
                reached[map_id] = min(reached[map_id], known[peer, map_id])
