"""Gossip where the medium may lose, delay, repeat and reorder what is said: only what the others say confirms.

As gossip on a perfect medium (`agent.exchange.gossip`), whose tables become hopes: what was on the air has probably
reached all in range. Beside them stands what is certain, for the peer has said so, or has said the units itself. A
hope that is not confirmed in time is given up, and what it was about is said again:

    event                                                  what follows
    units of a map are new, or known and said again        held: of that map, within `_every` steps
    a unit came behind others that one lacks               held: at once, and again every `NAG` steps; it is kept
    what was lacking came, and kept units go on from it    held: at once
    a peer says that it holds no more than was certain,    the hope is given up, the units are said again
    though a round trip ago it was sent more
    nothing is said by a peer for two round trips,         the same
    and the steps in which it may put off what it holds
    a peer has lacked something for as long                the next one passes it on as well

`From` goes before all units, for who has missed a broadcast does not know where the next one goes on. The more robots
and the narrower the medium, the more seldom one says what one holds: all together use the `SHARE`th part of it.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator

import numpy as np

from agent.exchange.gossip import PATIENCE, Bases, Gossip, Table, nothing
from agent.exchange.neighbors import Mask
from agent.exchange.places import NoPlaces
from protocol.packets import Held

NAG = 2
"""Steps after which it is said again that something is lacking."""

SHARE = 8
"""The part of the medium that saying what one holds may take."""

LEAST_TRIP = 2
"""Steps in which a word comes back at the soonest."""

LONGEST_TRIP = 64


class ConfirmedGossip(Gossip):
    """One robot's end of gossip, where only what the others say confirms."""

    def __init__(
        self,
        robot: int,
        robots: int,
        *,
        incarnations: int = 1,
        incarnation: int = 0,
        bases: Bases = nothing,
    ) -> None:
        super().__init__(robot, robots, incarnations=incarnations, incarnation=incarnation, bases=bases)
        self._certain: Table = np.zeros_like(self.known)
        self._hoping: Table = np.full_like(self.known, -1)
        """Since which step one hopes that a peer holds more of a map than is certain; -1: one does not."""
        self._trip = np.full(robots, LEAST_TRIP, np.int32)
        """Steps after which a word of each peer came back of late."""
        self._every = PATIENCE
        """Steps within which one says what one holds."""
        self._said_held: Table = np.zeros(len(self.logs), np.int32)
        """How much of each map one has said last that one holds."""
        self._again: set[int] = set()
        """Maps of which one has heard again what one holds."""
        self._early: defaultdict[int, dict[int, tuple[int, bytes]]] = defaultdict(dict)
        """Of each map the units that came behind others that one lacks, by their numbers: who said it, and what."""
        self._places = NoPlaces(robot, robots)

    @property
    def certain(self) -> Table:
        """``certain[peer, map]``: up to which unit the map has reached the peer, as it has said."""
        return self._certain

    def offers(self, round_number: int, peers: list[int], room: int | None) -> list[tuple[int, int, bytes]]:
        """Open an exchange: return what to broadcast, as [(EVERYONE, own number, frame)], or nothing."""
        if round_number == 0 and room:
            words = SHARE * Held.size * self._robots * (self._robots - 1)
            self._every = max(PATIENCE, math.ceil(words / room))
            self._turn = 2 * int(self._trip.max()) + self._every
        return super().offers(round_number, peers, room)

    # --- what is said

    def _look_who_lacks(self) -> None:
        hopes = self.known > self._certain
        self._hoping[~hopes] = -1
        self._hoping[hopes & (self._hoping < 0)] = self._step
        waited = self._step - self._hoping
        self._give_up(hopes & (waited > 2 * self._trip[:, None] + self._every))
        super()._look_who_lacks()

    def _give_up(self, hopes: Mask) -> None:
        self.known[hopes] = self._certain[hopes]
        self._hoping[hopes] = -1

    def _worth_reporting(self) -> Mask:
        due = super()._worth_reporting()
        news = self._held > self._said_held
        news[sorted(self._again)] = True
        due |= news & (self._step >= self._asked + self._every)
        for map_id in self._gaps:
            due[map_id] |= self._step >= self._asked[map_id] + NAG
        return due

    # --- what was heard

    def _settle(self, sent: int) -> None:
        super()._settle(sent)
        for end, map_id in self._said.held:
            if end <= sent:
                self._said_held[map_id] = len(self.logs[map_id])
                self._again.discard(map_id)

    def _recognise(self, peer: int, pieces: list[bytes]) -> None:
        incarnation = self._own_maps[peer]
        super()._recognise(peer, pieces)
        if self._own_maps[peer] != incarnation:
            self._certain[peer] = 0
            self._hoping[peer] = -1

    def _hear_held(self, peer: int, map_id: int, held: int) -> None:
        certain, hoping = int(self._certain[peer, map_id]), int(self._hoping[peer, map_id])
        if held > certain or self._lives > 1:
            self._certain[peer, map_id] = held
            if hoping >= 0 and held > certain:
                trip = max(self._step - hoping, int(self._trip[peer]) - 1)
                self._trip[peer] = min(max(trip, LEAST_TRIP), LONGEST_TRIP)
                self._hoping[peer, map_id] = self._step
        if hoping >= 0 and held <= certain and self._step - hoping >= self._trip[peer]:
            self.known[peer, map_id] = held
        self.known[peer, map_id] = max(int(self.known[peer, map_id]), held)

    def _take(
        self, peer: int, map_id: int, index: int | None, units: list[bytes]
    ) -> Iterator[tuple[int, int, bytes]]:
        if units and index is not None:
            end = index + len(units)
            self._certain[peer, map_id] = max(int(self._certain[peer, map_id]), end)
            if end <= len(self.logs[map_id]):
                self._again.add(map_id)
            elif index > len(self.logs[map_id]) and (peer, map_id) not in self.refused:
                self._early[map_id] |= dict(enumerate(((peer, unit) for unit in units), index))
        yield from super()._take(peer, map_id, index, units)
        yield from self._take_early(map_id)

    def _take_early(self, map_id: int) -> Iterator[tuple[int, int, bytes]]:
        """Yield the units that were kept of a map, as far as nothing is lacking before them any more.

        What was kept of a peer from whom nothing is taken by now counts as lacking.
        """
        early, log = self._early[map_id], self.logs[map_id]
        while (kept := early.pop(len(log), None)) is not None:
            self._gaps.add(map_id)
            peer, unit = kept
            if (peer, map_id) not in self.refused:
                yield peer, map_id, unit
        for number in [number for number in early if number < len(log)]:
            del early[number]
