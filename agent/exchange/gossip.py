"""Gossip: logs of all robots' maps by broadcast, one word heard by all in range (docs/protocol.md; ours, of no paper).

On a shared medium a broadcast costs once, however many hear it. A robot broadcasts units of its own log as they come;
who hears a unit that it holds ignores it. There are no handshakes: one round trip of the bus an exchange.

What a robot knows of others it knows from what is on the air. It has a table of how far each log has reached each
teammate, and one of who is in whose range; all of them say so when theirs changes. A broadcast that was carried has
reached all in range of who said it. So all who hear each other have the same tables, and of several who could pass on
what a robot lacks the same one is chosen by all: its maker, if it is one of them, else one by turns.

Events and what follows from them; the tables move with the relay's word of what was carried, and by nothing else:

    event                                             what is said, in this order
    one's range has changed                           near: who has come, who has left
    a teammate has come into range                    held: of each map of which one may hold more than it was told
    a unit came behind others that one lacks          held: how far one is; once in `PATIENCE` steps
    somebody has been out of range before             held: of one map, in turn; once in `SELDOM` steps
    a teammate in range lacks units of one's own log  from, and these
    one is chosen to pass on what a teammate lacks    from, and these

Who holds most is served first, and of the maps that it lacks the one of which it lacks least. A word that is built on
others' words goes behind those of them that the teammate lacks (`agent.encodings.base.Dependency`). So those who keep up
hear what is new before others hear what is old, and where much is lacking a few know all soon, and not all a part.
Nothing is said that nobody in range can use, for it lacks what comes before.

Who speaks first is in `agent.exchange.priority`.

A log of one's own goes on where its last broadcast ended, and nothing says where that was, unless somebody is in range
who has not been there since (`agent.exchange.places`): then `From` goes before it. The first `EARLY` units of a log
have a shorter one.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from agent.encodings.base import Dependency
from agent.exchange import priority
from agent.exchange.broadcast import Broadcast
from agent.exchange.log import Log
from agent.exchange.neighbors import Mask, Neighbors
from agent.exchange.outcome import Outcome
from agent.exchange.places import Places
from agent.exchange.reports import from_packet, held_packet, number, report
from protocol import packet_index, packets
from protocol.errors import ProtocolError
from protocol.kernels import kernel
from protocol.messages import NO_REPLIES, Replies
from protocol.packets import From, FromEarly, Gone, Held, HeldEarly, Near

Table = NDArray[np.int32]
Robots = list[int] | NDArray[np.intp]

Bases = Callable[[int], Sequence[Dependency]]
"""Of a map, in their order, the words that can only be read behind others' (`Round.bases`)."""

POLICY = "gossip"

EVERYONE = -1
"""Whom a broadcast is for."""

PATIENCE = 6
"""Steps after which a robot says again what it lacks; and, where nothing is lost, the next one passes it on."""

SELDOM = 16
"""Steps after which a robot that has not always had all others in range says what it holds of one more map."""

GREETING = 1
"""Steps after its coming into range in which a robot is not told what it may hold by then."""


def nothing(map_id: int) -> Sequence[Dependency]:
    """Words that stand each for itself."""
    del map_id
    return ()


@dataclass
class _Plan:
    """What a peer will hold of each map by what is said, and by what others say."""

    peer: int
    held: Table


class Gossip:
    """One robot's end of it; it stands where `agent.exchange.session.Session` does."""

    def __init__(
        self,
        robot: int,
        robots: int,
        *,
        incarnations: int = 1,
        incarnation: int = 0,
        bases: Bases = nothing,
    ) -> None:
        maps = robots * incarnations
        self.bases = bases
        self.logs = [Log() for _ in range(maps)]
        """What is held of every robot's map, of each of its lives (`agent.identity`)."""
        self.own = robot + robots * incarnation
        """The number of one's own map."""
        self.known: Table = np.zeros((robots, maps), np.int32)
        """``known[peer, map]``: up to which unit the map has reached the peer, as far as one can know."""
        self.refused: set[tuple[int, int]] = set()
        """(peer, map): what is not taken from a peer, for what came of it made no sense."""
        self.priority = 0
        """How soon what was said last should be on the air: the more, the shorter one waits for a free medium."""
        self._robot = robot
        self._robots = robots
        self._lives = incarnations
        self._own_maps = list(range(robots))
        """The number of each robot's own map, in the life that it is in, as far as one has heard."""
        self._own_maps[robot] = self.own
        self._step = 0
        self._peers: list[int] = []
        self._sure: list[int] = []
        """Those in range who have said what they hold, or had the time to."""
        self._neighbours = Neighbors(robot, robots)
        self._parted = False
        """Whether anybody has ever been out of one's range."""
        self._told: Table = np.zeros((robots, maps), np.int32)
        """``_told[peer, map]``: how much of a map the peer knows one to hold."""
        self._met: set[int] = set()
        """Who has come into range and has not been told what one holds."""
        self._unsure: dict[int, int] = {}
        """Until which step, at most, one waits for those who have come into range to say what they hold."""
        self._gaps: set[int] = set()
        """Maps of which a unit came behind others that are lacking."""
        self._asked = np.full(maps, -PATIENCE, np.int32)
        """The step in which one last said of a map what one holds."""
        self._begun = 0
        """Where what was last recorded begins in one's own log."""
        self._aired = 0
        """Up to which unit one's own log has been on the air."""
        self._places = Places(robot, robots, begun=not incarnation)
        self._lacks: Table = np.zeros((robots, maps), np.int32)
        """How many units that one holds a peer in range lacks of each map."""
        self._held: NDArray[np.int32] = np.zeros(maps, np.int32)
        """How many units of each map one held when the exchange was opened."""
        self._since: Table = np.zeros((robots, maps), np.int32)
        """Since which step it lacks some."""
        self._waits = 0
        """Since which step there is something to say that has not been on the air."""
        self._said = Broadcast()
        self._turn = PATIENCE
        """Steps after which the next one may pass on what a peer lacks."""
        self._forgotten: NDArray[np.int32] = np.zeros(maps, np.int32)
        """How many units of each map all teammates hold."""

    @property
    def certain(self) -> Table:
        """As `known`, of what nothing can have prevented: on a medium that loses nothing it is the same."""
        return self.known

    def record(self, units: list[bytes]) -> None:
        """Append to the log of one's own map."""
        if units:
            self._begun = len(self.logs[self.own])
        self.logs[self.own].append(units)

    def retract(self, count: int) -> bool:
        """Take the last `count` units of one's own log back, if nobody has heard any of them; say whether."""
        return self.logs[self.own].retract(count, self._aired)

    def offers(self, round_number: int, peers: list[int], room: int | None) -> list[tuple[int, int, bytes]]:
        """Open an exchange: return what to broadcast, as [(EVERYONE, own number, frame)], or nothing.

        `room` is what is left of the step's budget in bytes, None for no limit.
        """
        if round_number == 0:
            self._begin_step(peers)
        self._look_who_lacks()
        said = self._said = Broadcast(room)
        if not peers:
            return []
        self._report(said)
        self._set_priority(said, self._serve(said))
        return [(EVERYONE, self._robot, said.payload)] if said.payload else []

    def replies(self) -> Replies:
        """There is nothing to reply to."""
        return NO_REPLIES

    def answers(self, heard: list[tuple[int, int, bytes]]) -> list[tuple[int, int, bytes]]:
        """Nobody offers anything."""
        raise ProtocolError("conn", 0, f"{len(heard)} offers, but maps travel by gossip")

    def data(self, heard: list[tuple[int, int, int, bytes]]) -> list[tuple[int, int, bytes]]:
        """Nobody answers anything."""
        raise ProtocolError("conn", 0, f"{len(heard)} answers, but maps travel by gossip")

    def outcome(self, outcome: Outcome, heard: list[tuple[int, bytes]]) -> Iterator[tuple[int, int, bytes]]:
        """Move the tables by what was carried; yield the news that came, as (peer, map, frame).

        The caller appends the units of each with `accept` before it asks for the next, once it has made sense of
        them.
        """
        frames: list[tuple[int, list[bytes]]] = []
        for peer, payload in heard:
            try:
                frames.append((peer, packet_index.split(payload)))
            except ProtocolError:
                yield peer, peer, payload  # whoever makes sense of it will say what is wrong
        for peer, pieces in frames:
            self._recognise(peer, pieces)
        for peer, pieces in frames:  # reports speak of what was before this exchange
            yield from self._hear_reports(peer, pieces)
        for sent in outcome.data:
            self._settle(sent)
        for peer, pieces in frames:
            yield from self._hear_units(peer, pieces)

    def accept(self, peer: int, map_id: int, frame: bytes, ends: Sequence[int]) -> None:
        """Append units of a map that a peer said, given where in the frame they end."""
        del peer
        self.logs[map_id].extend(frame, ends)

    def delivered(self) -> bool:
        """Whether teammates are in range, and all that one has logged has been on the air."""
        return bool(self._peers) and self._aired == len(self.logs[self.own])

    def undelivered(self) -> int:
        """Units of one's own map that have not reached a teammate yet, all teammates counted."""
        held = len(self.logs[self.own])
        return held * (self._robots - 1) - int(np.delete(self.certain[:, self.own], self._robot).sum())

    def forget(self) -> None:
        """Drop what all teammates hold; where they may come back, and hold nothing then, that is nothing."""
        if self._lives > 1:
            return
        others = self.certain.copy()
        np.fill_diagonal(others, np.iinfo(np.int32).max)
        others[self._robot] = np.iinfo(np.int32).max
        reached = others.min(axis=0)
        for map_id in np.flatnonzero(reached > self._forgotten).tolist():
            self.logs[map_id].forget(int(reached[map_id]))
        self._forgotten = reached

    # --- what is said

    def _begin_step(self, peers: list[int]) -> None:
        """Note who is in range now."""
        self._step += 1
        begins = self._step == 1 and self.own < self._robots
        come = set() if begins else set(peers) - set(self._peers)
        self._met = (self._met | come) & set(peers)
        self._unsure |= dict.fromkeys(come, self._step + GREETING)
        self._places.in_range(peers)
        self._peers = peers
        self._parted = self._parted or len(peers) < self._robots - 1

    def _look_who_lacks(self) -> None:
        """Note who in range lacks what, and since when, as far as one can know."""
        self._sure = [peer for peer in self._peers if self._unsure.get(peer, 0) < self._step]
        sure = np.zeros(self._robots, np.bool_)
        sure[self._sure] = True
        self._held = np.array([len(log) for log in self.logs], np.int32)
        _note_lacks(
            self.known, self._held, sure, np.array(self._own_maps), self._step, self._lacks, self._since
        )

    def _report(self, said: Broadcast) -> None:
        """Say who is in range, where that has changed, and what one holds, where somebody should know."""
        for peer, here in self._neighbours.news(self._peers):
            if end := said.report(Near(peer) if here else Gone(peer)):
                said.near.append((end, peer, here))
        said.met = set(self._met)
        due = self._worth_reporting()
        due[self.own] = False
        for map_id in np.flatnonzero(due).tolist():
            if end := said.report(held_packet(map_id, len(self.logs[map_id]))):
                said.held.append((end, map_id))

    def _worth_reporting(self) -> Mask:
        """Maps of which somebody should know how much of them one holds."""
        held = self._held
        due: Mask = np.logical_or.reduce(self._told[sorted(self._met)] < held)
        for map_id in self._gaps:
            due[map_id] |= self._step >= self._asked[map_id] + PATIENCE
        if self._parted and self._step % SELDOM == self._robot % SELDOM:
            mine = np.arange(len(self.logs)) % self._robots == self._step // SELDOM % self._robots
            mine[self._robots :] &= held[self._robots :] > 0
            due |= mine
        return due

    def _serve(self, said: Broadcast) -> int | None:
        """Say what those in range lack, as far as it is for oneself; return who is served first, if anybody."""
        wanting = np.flatnonzero(self._lacks.any(axis=1)).tolist()
        holds = dict(zip(wanting, self.known[wanting].sum(axis=1).tolist(), strict=True))
        served = None
        for peer in sorted(wanting, key=lambda each: (-holds[each], each)):
            wanted = np.flatnonzero(self._lacks[peer]).tolist()
            plan = _Plan(peer, self.known[peer].copy())
            plan.held[self._own_maps[peer]] = np.iinfo(np.int32).max
            before = len(said.stretches)
            for map_id in sorted(wanted, key=lambda each: (each != self.own, self._lacks[peer, each], each)):
                self._bring(said, plan, map_id, int(self._held[map_id]))
            if served is None and len(said.stretches) > before:
                served = peer
        return served

    def _bring(self, said: Broadcast, plan: _Plan, map_id: int, end: int) -> None:
        """Say of a map what a peer lacks before unit `end`, and before each word what that one is built on."""
        bases = self.bases(map_id)
        for basis in bases[bisect_right(bases, plan.held[map_id], key=attrgetter("end")) :]:
            if basis.first >= end:
                break
            if any(plan.held[other] < units for other, units in basis.requires):
                self._say(said, plan, map_id, basis.first)
                for other, units in basis.requires:
                    self._bring(said, plan, other, units)
                if any(plan.held[other] < units for other, units in basis.requires):
                    return
        self._say(said, plan, map_id, end)

    def _say(self, said: Broadcast, plan: _Plan, map_id: int, end: int) -> None:
        """Say of a map what a peer lacks before unit `end`, as far as it is for oneself and has not been said."""
        first = int(plan.held[map_id])
        if first >= end:
            return
        low, high = said.spoken.get(map_id, (end, end))
        if low <= first:
            first = max(first, high)
        else:
            end = min(end, low)
        if first < end and (map_id == self.own or self._is_chosen(plan.peer, map_id)):
            end = self._stretch(said, map_id, first, end)
        plan.held[map_id] = max(first, end)

    def _is_chosen(self, peer: int, map_id: int) -> bool:
        """Whether it is for oneself to pass on what a peer lacks of a map.

        Of those who hold more of it than the peer and are in its range it is the maker, else one by turns; after
        `_turn` steps in which the peer has not got it the next one does as well.
        """
        able = [
            each
            for each in self._peers
            if self._neighbours.are_near(each, peer)
            and (self._own_maps[each] == map_id or self.known[each, map_id] > self.known[peer, map_id])
        ]
        able.append(self._robot)
        able.sort(key=lambda each: (self._own_maps[each] != map_id, (each - map_id) % self._robots))
        return able.index(self._robot) <= (self._step - int(self._since[peer, map_id])) // self._turn

    def _stretch(self, said: Broadcast, map_id: int, first: int, end: int) -> int:
        """Say units `first` to `end` - 1 of a log as far as there is room, behind a `From` where it is needed.

        Return up to which one there is.
        """
        log = self.logs[map_id]
        first, end = max(first, log.oldest), min(end, len(log))
        goes_on = map_id == self.own and not said.stretches and self._places.known(first, self._peers)
        head = b"" if goes_on else packets.encode([from_packet(map_id, first)])
        return said.stretch(map_id, log, first, end, head)

    def _set_priority(self, said: Broadcast, served: int | None) -> None:
        """Note how soon this should be on the air; `served` is who is served first."""
        if not said.payload:
            self._waits = self._step
        waited = self._step - self._waits
        if self._parted:
            holds = 0 if served is None else int(self.known[served].sum())
            self.priority = priority.among_some(holds, waited)
        else:
            lacks = 0 if served is None else int(self._lacks[served].sum())
            begun = self._begun < self._aired < len(self.logs[self.own])
            self.priority = priority.among_all(lacks, len(said.payload), waited, begun=begun)

    # --- what was heard

    def _settle(self, sent: int) -> None:
        """So many bytes of one's broadcast were on the air: all in range have heard them."""
        said = self._said
        for end, peer, here in said.near:
            if end <= sent:
                self._neighbours.told(self._peers, peer, here)
        for end, map_id in said.held:
            if end <= sent:
                self._asked[map_id] = self._step
                self._gaps.discard(map_id)
                self._believe(self._peers, map_id, len(self.logs[map_id]))
        if all(end <= sent for end, _ in said.held):
            self._met -= said.met
        for stretch in said.stretches:
            end = self.logs[stretch.map].reached(stretch.first, min(sent, stretch.end) - stretch.begin)
            if end <= stretch.first:
                break
            self._believe(self._peers, stretch.map, end)
            self._reach(self._peers, stretch.map, stretch.first, end)
            if stretch.map == self.own:
                self._places.said(end, self._peers)
                self._aired = max(self._aired, end)
            elif stretch.map % self._robots == self._robot:
                self._places.said_of_another_life()
        if sent:
            self._waits = self._step

    def _recognise(self, peer: int, pieces: list[bytes]) -> None:
        """Who says units of the map of a new life of its own has begun anew, and knows and holds nothing."""
        for piece in pieces if self._lives > 1 else ():
            said = report(piece)
            if not isinstance(said, From | FromEarly) or not self._own_maps[peer] < said.map < len(self.logs):
                continue
            if said.map % self._robots == peer:
                self._own_maps[peer] = said.map
                self._places.begins_anew(peer)
                self.known[peer] = 0
                self._told[peer] = 0
                self._neighbours.begins_anew(peer)
                self._met.add(peer)

    def _hear_reports(self, peer: int, pieces: list[bytes]) -> Iterator[tuple[int, int, bytes]]:
        """Take who is near a peer, and what it holds; yield what does not belong here."""
        for piece in pieces:
            match report(piece):
                case Near(robot) if robot < self._robots:
                    self._neighbours.says(peer, robot, True)
                case Gone(robot) if robot < self._robots:
                    self._neighbours.says(peer, robot, False)
                case (Held(map_id, _) | HeldEarly(map_id, _)) as held if map_id < len(self.logs) and (
                    map_id != peer or self._lives > 1
                ):
                    self._hear_held(peer, map_id, self._heard_most(map_id, self._number(held)))
                    self._unsure.pop(peer, None)
                    self._neighbours.says(peer, self._robot, True)
                case From(map_id, _) | FromEarly(map_id, _) if map_id < len(self.logs):
                    pass
                case None:
                    pass
                case other:
                    yield peer, peer, packets.encode([other])

    def _hear_held(self, peer: int, map_id: int, held: int) -> None:
        """A peer says how many units of a map it holds."""
        self.known[peer, map_id] = held

    def _hear_units(self, peer: int, pieces: list[bytes]) -> Iterator[tuple[int, int, bytes]]:
        """Take what a peer said of logs; yield what is news."""
        stretches: list[tuple[int, int | None, list[bytes]]]
        stretches = [(self._own_maps[peer], self._places.of(peer), [])]
        for piece in pieces:
            said = report(piece)
            if said is None:
                stretches[-1][2].append(piece)
            elif isinstance(said, From | FromEarly) and said.map < len(self.logs):
                stretches.append((said.map, self._number(said), []))
        for map_id, index, units in stretches:
            if index is not None:
                del units[max(0, self._heard_most(map_id, index + len(units)) - index) :]
            yield from self._take(peer, map_id, index, units)

    def _take(
        self, peer: int, map_id: int, index: int | None, units: list[bytes]
    ) -> Iterator[tuple[int, int, bytes]]:
        """A peer said units of a map, from number `index` on: yield those that are news."""
        if not units:
            return
        if index is None:
            self._gaps.add(map_id)
            return
        end, held = index + len(units), len(self.logs[map_id])
        if map_id == self._own_maps[peer]:
            self._places.heard(peer, end)
        self.known[peer, map_id] = max(int(self.known[peer, map_id]), end)
        if index > held:
            self._gaps.add(map_id)
        else:
            self._gaps.discard(map_id)
        mine = map_id % self._robots == self._robot and map_id >= self.own
        if index <= held < end and not mine and (peer, map_id) not in self.refused:
            yield peer, map_id, b"".join(units[held - index :])
        hearers = self._neighbours.hearers(peer)
        self._reach(np.flatnonzero(hearers), map_id, index, end)
        if len(self.logs[map_id]) >= end:
            hearers[[peer, self._robot]] = True
            self._believe(np.flatnonzero(hearers), map_id, end)

    def _reach(self, peers: Robots, map_id: int, first: int, end: int) -> None:
        """Peers have heard units `first` to `end` - 1 of a map; each takes them unless it lacks earlier ones."""
        known = self.known[peers, map_id]
        self.known[peers, map_id] = np.where(known >= first, np.maximum(known, end), known)

    def _believe(self, peers: Robots, map_id: int, held: int) -> None:
        """Peers have heard that one holds so many units of a map."""
        self._told[peers, map_id] = np.maximum(self._told[peers, map_id], held)

    def _heard_most(self, map_id: int, units: int) -> int:
        """Of so many units of a map that a peer speaks of: of one's own nobody holds what has not been on the air."""
        return min(units, self._aired) if map_id == self.own else units

    def _number(self, said: From | FromEarly | Held | HeldEarly) -> int:
        return number(said, len(self.logs[said.map]))


@kernel("void(int32[:,::1], int32[::1], boolean[::1], int64[::1], int64, int32[:,::1], int32[:,::1])")
def _note_lacks(
    known: Table,
    held: NDArray[np.int32],
    sure: Mask,
    own_maps: NDArray[np.int64],
    step: int,
    lacks: Table,
    since: Table,
) -> None:
    """Note how much each peer that one is `sure` of lacks of each map that is not its own, and since when."""
    robots, maps = known.shape
    for peer in range(robots):
        for map_id in range(maps):
            lack = 0
            if sure[peer] and map_id != own_maps[peer]:
                lack = max(held[map_id] - known[peer, map_id], 0)
            if lack and not lacks[peer, map_id]:
                since[peer, map_id] = step
            lacks[peer, map_id] = lack
