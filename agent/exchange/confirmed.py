"""The session where the medium may lose, delay, repeat and reorder what is said: only what the other says confirms.

As the session of a perfect medium (`agent.exchange.session`), of which it has the logs, the table and the rules of
whom to offer what. But nothing follows from what was on the air, and each frame says by itself what it is about, so
that it does not matter when it comes, how often, and behind which others:

    event                                     what is said to the peer, in the next exchange
    there is news for it, nothing is awaited  offer: the map, and the block that it is thought to be in
    it offers a map, or sends some of it      held: how much of the map one holds by now
    it said what it holds of late, and that   from, and the units from there on
    is less
    no word came for as long as a round trip  offer again; each time twice as long is waited
    of late, and some

What it has to say to one peer goes in one frame: reports, then offers, then units. Its table moves when a peer says
what it holds, or shows that it holds units by sending them, and by nothing else. Units that one holds already are
ignored, and so are those that come behind others that one lacks: the next word of what is held brings them again.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from agent.exchange.handshake import offer
from agent.exchange.outcome import Outcome
from agent.exchange.reports import from_packet, held_packet, number, report
from agent.exchange.session import MAX_WAIT, PATIENCE, Session, Table
from protocol import packet_index, packets
from protocol.errors import ProtocolError
from protocol.messages import NO_REPLIES, Replies
from protocol.packets import From, FromEarly, Held, HeldEarly, Offer

LEAST_WAIT = 2
"""Exchanges in which a word can come back at the soonest: it is said in one and answered in the next."""

MOST_WAIT = 16
"""Exchanges after which one asks again at the latest, if a round trip is known to take much less."""

OF_LATE = 8
"""Exchanges after which one asks again what a peer holds before one sends it more."""

Pair = tuple[int, int]
"""A peer, and whose map."""


@dataclass
class _Frame:
    """What is said to one peer, and where in it each report and offer ends, in bytes."""

    payload: bytes = b""
    reports: list[tuple[int, Pair]] = field(default_factory=list)
    offers: list[tuple[int, Pair]] = field(default_factory=list)
    units: list[tuple[int, int, Pair, int]] = field(default_factory=list)
    """Where units of a log begin and end, and from which number on they are."""


class ConfirmedSession(Session):
    """One robot's end of all connections, where only what the other says confirms."""

    def __init__(
        self, robot: int, robots: int, policy: str = "backoff", *, incarnations: int = 1, incarnation: int = 0
    ) -> None:
        super().__init__(robot, robots, policy, incarnations=incarnations, incarnation=incarnation)
        self._owed: set[Pair] = set()
        """Whom one is to tell how much of which map one holds."""
        self._word: dict[Pair, int] = {}
        """The exchange in which a peer said last what it holds of a map."""
        self._spoken: dict[Pair, int] = {}
        """The exchange in which one spoke to a peer of a map; it is taken out when a word comes."""
        self._tries: dict[Pair, int] = {}
        """How often one has since the last word."""
        self._trip: dict[Pair, int] = {}
        """Exchanges after which a word came back last, of those that one had spoken for once only,
        if there are any."""
        self._frames: list[_Frame] = []
        self._aired = 0
        """Units of one's own log that have been on the air."""

    @cached_property
    def _wait(self) -> Table:
        return np.full((self._robots, len(self.logs)), LEAST_WAIT, np.int64)

    def retract(self, count: int) -> bool:
        """Take the last `count` units of one's own log back, if none of them has been on the air; say whether."""
        return self.logs[self.own].retract(count, self._aired)

    def offers(self, round_number: int, peers: list[int], room: int | None) -> list[tuple[int, int, bytes]]:
        """Open an exchange: return what to say, one frame a peer, as (peer, map, frame)."""
        self._now += 1
        self._only_first = self._only_first and round_number == 0
        self._room = room
        self._peers = peers
        held = np.array([len(log) for log in self.logs], np.int64)
        chosen = self._worth_offering(round_number, held) if peers and held.any() else []
        chosen = [pair for pair in chosen if self._now >= self._due[pair]]
        left = room
        said: list[tuple[int, int, bytes]] = []
        self._frames = []
        for peer in peers:
            frame = _Frame()
            map_id = [pair for pair in chosen if pair[0] == peer]
            send = [pair for pair in map_id if self._now <= self._word.get(pair, -MAX_WAIT) + OF_LATE]
            self._report(frame, peer)
            self._offer(frame, [pair for pair in map_id if pair not in send])
            for pair in send:
                self._send(frame, pair, left)
            if frame.payload:
                self._frames.append(frame)
                said.append((peer, map_id[0][1] if map_id else peer, frame.payload))
                left = None if left is None else max(0, left - len(frame.payload))
        return said

    def replies(self) -> Replies:
        """Nothing is said before the medium opens next."""
        return NO_REPLIES

    def answers(self, heard: list[tuple[int, int, bytes]]) -> list[tuple[int, int, bytes]]:
        """Answers are said when the medium opens next."""
        raise ProtocolError("conn", 0, f"{len(heard)} offers out of turn")

    def data(self, heard: list[tuple[int, int, int, bytes]]) -> list[tuple[int, int, bytes]]:
        """Data are said when the medium opens next."""
        raise ProtocolError("conn", 0, f"{len(heard)} answers out of turn")

    def outcome(self, outcome: Outcome, heard: list[tuple[int, bytes]]) -> Iterator[tuple[int, int, bytes]]:  # type: ignore[override]
        """Note what was on the air, and take what came; yield the news in it, as (peer, map, frame).

        The caller appends the units of each with `accept` before it asks for the next, once it has made sense of
        them.
        """
        for frame, sent in zip(self._frames, outcome.data, strict=False):
            self._settle_frame(frame, sent)
        self._frames = []
        for peer, payload in heard:
            yield from self._hear(peer, packet_index.split(payload))

    def delivered(self) -> bool:
        """Whether teammates were in range when the medium last opened, and all said to hold one's own log.

        But for those from whom no word comes (`PATIENCE`).
        """
        held = len(self.logs[self.own])
        if not self._peers or not held:
            return bool(self._peers)
        return all(
            self.known[peer, self.own] >= held or self._tries.get((peer, self.own), 0) > PATIENCE
            for peer in self._peers
        )

    # --- what is said

    def _report(self, frame: _Frame, peer: int) -> None:
        for map_id in sorted(each for to, each in self._owed if to == peer):
            frame.payload += packets.encode([held_packet(map_id, len(self.logs[map_id]))])
            frame.reports.append((len(frame.payload), (peer, map_id)))

    def _offer(self, frame: _Frame, pairs: list[Pair]) -> None:
        for peer, map_id in pairs:
            frame.payload += offer(map_id, int(self.known[peer, map_id]))
            frame.offers.append((len(frame.payload), (peer, map_id)))

    def _send(self, frame: _Frame, pair: Pair, room: int | None) -> None:
        """Send the units that a peer lacks of a map, as many as there is room for."""
        peer, map_id = pair
        first = max(int(self.known[peer, map_id]), self.logs[map_id].oldest)
        head = packets.encode([from_packet(map_id, first)])
        left = None if room is None else room - len(frame.payload) - len(head)
        units = self.logs[map_id].since(first, left)
        if units:
            frame.payload += head
            begin = len(frame.payload)
            frame.payload += units
            frame.units.append((begin, len(frame.payload), pair, first))

    # --- what becomes of it

    def _settle_frame(self, frame: _Frame, sent: int) -> None:
        """So many bytes of a frame were on the air; whether they were heard its hearer will say."""
        for end, pair in frame.reports:
            if end <= sent:
                self._owed.discard(pair)
        spoken = {pair for end, pair in frame.offers if end <= sent}
        for begin, end, pair, first in frame.units:
            reached = self.logs[pair[1]].reached(first, min(sent, end) - begin)
            if reached > first:
                spoken.add(pair)
                self._word.pop(pair, None)
                if pair[1] == self.own:
                    self._aired = max(self._aired, reached)
        for pair in spoken:
            tries = self._tries[pair] = self._tries.get(pair, 0) + 1
            if tries > 1:
                longest = max(MOST_WAIT, 4 * self._trip[pair]) if pair in self._trip else MAX_WAIT
                self._wait[pair] = min(2 * int(self._wait[pair]), longest)
            self._spoken[pair] = self._now
            self._due[pair] = self._now + int(self._wait[pair])

    def _hear(self, peer: int, pieces: list[bytes]) -> Iterator[tuple[int, int, bytes]]:
        """Take a frame; yield the units in it that are news."""
        map_id, first, units = -1, 0, list[bytes]()
        for piece in pieces:
            said = report(piece)
            if said is None:
                units.append(piece)
                continue
            yield from self._take(peer, map_id, first, units)
            units = []
            match said:
                case (Held(map, _) | HeldEarly(map, _)) as held if map < len(self.logs):
                    self._confirm((peer, map), number(held, len(self.logs[map])))
                case Offer(map, _) if map < len(self.logs):
                    self._recognise(peer, map)
                    self._owe((peer, map))
                case (From(map, _) | FromEarly(map, _)) as begin if map < len(self.logs):
                    self._recognise(peer, map)
                    map_id, first = map, number(begin, len(self.logs[map]))
        yield from self._take(peer, map_id, first, units)

    def _take(
        self, peer: int, map_id: int, first: int, units: list[bytes]
    ) -> Iterator[tuple[int, int, bytes]]:
        """A peer sent units of a map, from number `first` on: yield those that are news."""
        if not units or map_id < 0:
            return
        held, end = len(self.logs[map_id]), first + len(units)
        self._owe((peer, map_id))
        self._learn((peer, map_id), end)
        if first <= held < end and not self._is_mine(map_id):
            yield peer, map_id, b"".join(units[held - first :])

    def _owe(self, pair: Pair) -> None:
        """A peer is to be told how much one holds, unless its word about that map is not wanted."""
        if not self._is_mine(pair[1]) and pair not in self.refused:
            self._owed.add(pair)

    def _is_mine(self, map_id: int) -> bool:
        """Whether a map is one's own, of this life or of one to come."""
        return map_id % self._robots == self._robot and map_id >= self.own

    def _recognise(self, peer: int, map_id: int) -> None:
        """Who speaks of the map of a new life of its own has begun anew: nothing that it said before holds."""
        known = int(self._own_maps[peer])
        super()._recognise(peer, map_id)
        if self._own_maps[peer] != known:
            self._wait[peer] = LEAST_WAIT
            for table in (self._word, self._spoken, self._tries, self._trip):
                for pair in [pair for pair in table if pair[0] == peer]:
                    del table[pair]

    def _confirm(self, pair: Pair, held: int) -> None:
        """A peer says how much it holds of a map."""
        if self._lives > 1:
            self.known[pair] = 0  # an older word may come late, of a life that held more
        self._learn(pair, held)
        self._word[pair] = self._now
        spoken = self._spoken.pop(pair, None)
        tries = self._tries.pop(pair, 0)
        if spoken is not None and (tries == 1 or pair not in self._trip):
            self._trip[pair] = self._now - spoken
        if pair in self._trip:
            self._wait[pair] = min(max(LEAST_WAIT, self._trip[pair] + 1), MAX_WAIT)
        self._due[pair] = self._now

    def _learn(self, pair: Pair, held: int) -> None:
        """A peer holds so many units of a map, or more; of one's own map nobody holds more than oneself."""
        if pair[1] == self.own:
            held = min(held, len(self.logs[self.own]))
        self.known[pair] = max(int(self.known[pair]), held)
