"""Gossip: what one knows reaches all who can be reached, in order, and is not said twice without need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.encodings.base import Dependency
from agent.exchange.confirmed_gossip import ConfirmedGossip
from agent.exchange.gossip import EVERYONE, GREETING, PATIENCE, SELDOM, Gossip
from agent.exchange.outcome import Outcome
from agent.exchange.priority import HOLDS, MOST_URGENT
from protocol import packet_index, packets
from protocol.errors import ProtocolError
from protocol.packets import (
    GOSSIP_WINDOW,
    Delete,
    Fragment,
    From,
    FromEarly,
    Gone,
    Held,
    HeldEarly,
    Near,
    Offer,
    Save,
    Target,
    encode,
)
from tests.agent.exchange.session_link import everyone, line, word, words

Reach = Mapping[int, Sequence[int]]
seeds = st.integers(0, 2**32 - 1)


class Air:
    """Robots that gossip, and the air between them: broadcasts in a drawn order, cut by a budget."""

    def __init__(self, robots: int, seed: int = 0) -> None:
        self.robot_settings = [Gossip(robot, robots) for robot in range(robots)]
        self.logged = [0] * robots
        self.rng = np.random.default_rng(seed)
        self.carried = 0
        self.said: list[tuple[int, bytes]] = []
        """Who said what in the last exchange, as far as it was carried."""

    def log(self, robot: int, count: int) -> None:
        """Let a robot log so many units of its own map."""
        self.robot_settings[robot].record(words(robot, self.logged[robot], self.logged[robot] + count))
        self.logged[robot] += count

    def step(self, reach: Reach, budget: int | None = None, rounds: int = 1) -> None:
        """Play a step; `reach` says who is in whose range, those missing are dead."""
        for round_number in range(rounds):
            budget = self._round(round_number, reach, budget)

    def _round(self, round_number: int, reach: Reach, budget: int | None) -> int | None:
        self.said = []
        spoken: dict[int, bytes] = {}
        for robot, peers in sorted(reach.items()):
            frames = self.robot_settings[robot].offers(round_number, list(peers), budget)
            for receiver, map_id, frame in frames:
                assert (receiver, map_id) == (EVERYONE, robot)
                assert peers
                assert budget is None or len(frame) <= budget
                spoken[robot] = frame
        heard: dict[int, list[tuple[int, bytes]]] = {robot: [] for robot in reach}
        sent: dict[int, list[int]] = {robot: [] for robot in reach}
        for robot in self.rng.permutation(sorted(spoken)).tolist():
            frame = spoken[robot]
            size = len(frame) if budget is None else packet_index.fitting(frame, budget)
            budget = None if budget is None else budget - size
            sent[robot] = [size]
            self.carried += size
            if size:
                self.said.append((robot, frame[:size]))
                for peer in reach.keys() & reach[robot]:
                    heard[peer].append((robot, frame[:size]))
        for robot in reach:
            own, count = sent[robot], len(heard[robot])
            zeros = [0] * len(own)
            note = Outcome(1, round_number, [-1] * len(own), zeros, zeros, own, [-1] * count, False)
            for peer, map_id, data in self.robot_settings[robot].outcome(note, heard[robot]):
                self.robot_settings[robot].accept(peer, map_id, data, packet_index.ends(data))
        for robot in reach:
            self.check(robot)
            self.robot_settings[robot].forget()
        return budget

    def check(self, robot: int) -> None:
        """What a robot holds of each map is what its maker logged, from the first unit on, whole and in order."""
        for map_id, log in enumerate(self.robot_settings[robot].logs):
            assert log.since(log.oldest, None) == b"".join(words(map_id, log.oldest, len(log)))
            assert len(log) <= self.logged[map_id]

    def agree(self, robots: Sequence[int]) -> bool:
        """Whether each of these holds all that any of them holds."""
        held = [[len(log) for log in self.robot_settings[robot].logs] for robot in robots]
        return all(row == np.max(held, axis=0).tolist() for row in held)


def drawn_reach(rng: np.random.Generator, robots: int, chance: float) -> Reach:
    links = np.triu(rng.random((robots, robots)) < chance, 1)
    links |= links.T
    return {robot: np.flatnonzero(links[robot]).tolist() for robot in range(robots)}


@given(st.integers(2, 6), seeds)
def test_where_all_hear_each_other_each_unit_is_said_once_and_nothing_else(robots: int, seed: int) -> None:
    air = Air(robots, seed)
    size = 0
    for _ in range(6):
        for robot in range(robots):
            count = int(air.rng.integers(0, 4))
            size += sum(map(len, words(robot, air.logged[robot], air.logged[robot] + count)))
            air.log(robot, count)
        air.step(everyone(robots))
        assert air.agree(range(robots))
        assert all(
            len(mind.logs[robot]) == air.logged[robot]
            for mind in air.robot_settings
            for robot in range(robots)
        )
    assert air.carried == size


@given(seeds)
def test_a_word_comes_behind_the_words_that_it_is_built_on(seed: int) -> None:
    rng = np.random.default_rng(seed)
    air, sizes = Air(3, seed), (12, 9, 0)
    for robot, count in enumerate(sizes):
        air.log(robot, count)
    air.step({0: [1], 1: [0], 2: []})
    bases: dict[int, list[Dependency]] = {0: [], 1: []}
    held, words_of = [0, 0], [[*range(0, size, 3)] for size in sizes[:2]]
    order = rng.permutation([0] * len(words_of[0]) + [1] * len(words_of[1])).tolist()
    for map_id in order:  # in this order the words were written, each on all others by then
        first, other = held[map_id], 1 - map_id
        bases[map_id].append(Dependency(first, first + 3, ((other, held[other]),)))
        held[map_id] += 3
    teller, hearer = air.robot_settings[0], air.robot_settings[2]
    teller.bases = lambda map_id: bases.get(map_id, [])
    for _ in range(40):
        air.step({0: [2], 1: [], 2: [0]}, 40)
        for map_id in (0, 1):
            for basis in bases[map_id]:
                if basis.first < len(hearer.logs[map_id]):
                    assert all(len(hearer.logs[other]) >= units for other, units in basis.requires)
    assert [len(log) for log in hearer.logs] == list(sizes)


@given(st.integers(2, 5), seeds, st.integers(15, 60))
def test_a_narrow_medium_cuts_between_units_and_what_was_cut_goes_on_later(
    robots: int, seed: int, budget: int
) -> None:
    air = Air(robots, seed)
    size = 0
    for robot in range(robots):
        count = int(air.rng.integers(0, 12))
        size += sum(map(len, words(robot, 0, count)))
        air.log(robot, count)
    for _ in range(20 * robots):
        air.step(everyone(robots), budget)
    assert air.agree(range(robots))
    assert air.carried == size


@given(st.integers(2, 6), seeds, st.sampled_from((None, 40, 200)), st.floats(0.1, 0.9))
def test_whoever_meets_whom_logs_are_never_wrong_and_agree_once_all_are_together(
    robots: int, seed: int, budget: int | None, chance: float
) -> None:
    air = Air(robots, seed)
    for _ in range(12):
        for robot in range(robots):
            air.log(robot, int(air.rng.integers(0, 3)))
        air.step(drawn_reach(air.rng, robots, chance), budget, rounds=2)
    for _ in range(SELDOM * robots * 8):
        air.step(everyone(robots), budget)
        if air.agree(range(robots)):
            break
    assert air.agree(range(robots))
    assert [len(log) for log in air.robot_settings[0].logs] == air.logged


@given(st.integers(3, 6), seeds)
def test_along_a_chain_all_reaches_both_ends(robots: int, seed: int) -> None:
    air = Air(robots, seed)
    for _ in range(8):
        for robot in range(robots):
            air.log(robot, int(air.rng.integers(0, 3)))
        air.step(line(robots))
    for _ in range(SELDOM * robots * 4):
        air.step(line(robots))
    assert air.agree(range(robots))
    assert [len(log) for log in air.robot_settings[0].logs] == air.logged


def test_two_halves_that_met_once_know_all_of_both() -> None:
    air = Air(4)
    apart = {0: [1], 1: [0], 2: [3], 3: [2]}
    for _ in range(10):
        for robot in range(4):
            air.log(robot, 1)
        air.step(apart)
    assert not air.agree(range(4))
    before = air.carried
    for _ in range(PATIENCE):
        air.step(everyone(4))
    assert air.agree(range(4))
    once = sum(len(word(robot, number)) for robot in range(4) for number in range(10))
    assert air.carried - before < 2.5 * once


def test_what_a_dead_robot_told_one_teammate_reaches_the_others() -> None:
    air = Air(4)
    air.log(3, 5)
    air.step({0: [], 1: [], 2: [3], 3: [2]})
    for _ in range(PATIENCE * 4):
        air.step({0: [1], 1: [0, 2], 2: [1]})
    assert [len(air.robot_settings[robot].logs[3]) for robot in range(3)] == [5, 5, 5]


def test_of_several_who_could_pass_a_map_on_one_does() -> None:
    air = Air(5)
    air.log(0, 4)
    air.step({0: [1, 2, 3], 1: [0, 2, 3], 2: [0, 1, 3], 3: [0, 1, 2], 4: []})
    said: list[int] = []
    for _ in range(GREETING + 3):
        air.step({1: [2, 3, 4], 2: [1, 3, 4], 3: [1, 2, 4], 4: [1, 2, 3]})
        said += [who for who, frame in air.said if packets.encode([FromEarly(0, 0)]) in frame]
    assert len(air.robot_settings[4].logs[0]) == 4
    assert len(said) == 1


def test_who_has_missed_nothing_needs_no_head_and_who_has_gets_one() -> None:
    air = Air(3)
    air.log(0, 1)
    air.step({0: [1], 1: [0], 2: []})
    assert dict(air.said)[0] == encode([Gone(2)]) + word(0, 0)
    assert dict(air.said)[1].startswith(encode([Gone(2)]))
    air.log(0, 1)
    air.step({0: [1], 1: [0], 2: []})
    assert not [
        packet for packet in packets.decode(dict(air.said)[0]) if isinstance(packet, From | FromEarly)
    ]
    assert word(0, 1) in dict(air.said)[0]
    air.log(0, 1)
    air.step(everyone(3))
    assert encode([FromEarly(0, 2)]) + word(0, 2) in dict(air.said)[0]
    for _ in range(GREETING + 2):
        air.step(everyone(3))
    assert len(air.robot_settings[2].logs[0]) == 3


def test_who_meets_says_what_it_holds_and_only_what_has_changed_since() -> None:
    air = Air(3)
    for robot in range(3):
        air.log(robot, 2)
    air.step(everyone(3))
    air.log(2, 1)
    air.step({0: [], 1: [2], 2: [1]})
    air.step(everyone(3))
    held = {
        (who, packet)
        for who, frame in air.said
        for packet in packets.decode(frame)
        if isinstance(packet, Held | HeldEarly)
    }
    assert (1, HeldEarly(2, 3)) in held
    assert not [packet for who, packet in held if packet.map in (0, 1) and who != 0]


def test_only_what_has_never_been_on_the_air_is_taken_back() -> None:
    air = Air(2)
    air.log(0, 3)
    assert air.robot_settings[0].retract(1)
    air.logged[0] -= 1
    air.step(everyone(2), len(word(0, 0)))
    assert not air.robot_settings[0].retract(2)
    assert air.robot_settings[0].retract(1)
    air.logged[0] -= 1
    air.step(everyone(2))
    assert len(air.robot_settings[1].logs[0]) == 1
    assert not air.robot_settings[0].retract(1)


def test_all_is_delivered_once_it_has_been_on_the_air_with_somebody_in_range() -> None:
    air = Air(2)
    assert not air.robot_settings[0].delivered()
    air.step(everyone(2))
    assert air.robot_settings[0].delivered()
    air.log(0, 2)
    air.step(everyone(2), len(word(0, 0)))
    assert not air.robot_settings[0].delivered()
    assert air.robot_settings[0].undelivered() == 1
    air.step(everyone(2))
    assert air.robot_settings[0].delivered()
    air.step({0: [], 1: []})
    assert not air.robot_settings[0].delivered()


def test_who_has_begun_a_unit_is_the_most_urgent_and_who_waits_becomes_more_so() -> None:
    mind = Gossip(0, 2)
    mind.record(words(0, 0, 2))
    urgent = []
    for step, carried in enumerate((0, 0, len(word(0, 0)))):
        mind.offers(0, [1], 100)
        urgent.append(mind.priority)
        assert not list(mind.outcome(Outcome(step, 0, [-1], [0], [0], [carried], [], False), []))
    assert 0 < urgent[0] < urgent[1] < urgent[2] < MOST_URGENT
    mind.offers(0, [1], 100)
    assert mind.priority == MOST_URGENT


def test_where_robots_have_been_apart_who_serves_one_that_holds_most_speaks_first() -> None:
    known, priority = 400, []
    for held in (known, 0):
        mind = Gossip(0, 3)
        mind.offers(0, [1], 100)  # robot 2 is away
        mind.logs[1].append(words(1, 0, known))
        mind.known[2, 1] = held
        mind.record(words(0, 0, 1))
        for _ in range(GREETING + 2):
            mind.offers(0, [2], 100)
        priority.append(mind.priority)
    assert priority[0] == priority[1] + known // HOLDS < MOST_URGENT


def test_numbers_of_units_are_told_modulo_the_window_and_meant_as_they_are_nearest() -> None:
    pair = [Gossip(robot, 2) for robot in range(2)]
    for mind in pair:
        for _ in range(16):
            mind.logs[0].append([encode([Save()])] * (GOSSIP_WINDOW // 16))
            mind.logs[0].forget(len(mind.logs[0]))
        mind.logs[0].append([encode([Save()])] * 5)
    frame = encode([From(0, 5), Delete(1), Save()])
    note = Outcome(1, 0, [], [], [], [], [-1], False)
    pair[1].offers(0, [0], None)
    assert list(pair[1].outcome(note, [(0, frame)])) == [(0, 0, encode([Delete(1), Save()]))]


def test_who_keeps_up_hears_what_is_new_before_who_was_away_hears_what_is_old() -> None:
    air = Air(3)
    apart, met = {0: [1], 1: [0], 2: []}, {0: [1, 2], 1: [0, 2], 2: [0, 1]}
    for _ in range(10):
        air.log(0, 1)
        air.step(apart)
    for _ in range(GREETING + 1):
        air.step(met)
    air.log(0, 1)
    air.step(met, budget=40)
    assert len(air.robot_settings[1].logs[0]) == 11
    for _ in range(20):
        air.step(met, budget=40)
    assert len(air.robot_settings[2].logs[0]) == 11


def test_nothing_is_said_that_all_in_range_lack_the_units_before() -> None:
    air = Air(3)
    for _ in range(4):
        air.log(0, 2)
        air.step({0: [1], 1: [0], 2: []})
    for _ in range(GREETING + 1):
        air.step({0: [2], 1: [], 2: [0]}, budget=20)
    air.log(0, 1)
    for _ in range(12):
        before = len(air.robot_settings[2].logs[0])
        air.step({0: [2], 1: [], 2: [0]}, budget=20)
        units = [p for _, frame in air.said for p in packets.decode(frame) if isinstance(p, Fragment)]
        assert not units or len(air.robot_settings[2].logs[0]) > before
    assert len(air.robot_settings[2].logs[0]) == 9


def test_where_maps_travel_by_gossip_nobody_offers_or_answers() -> None:
    with pytest.raises(ProtocolError, match="gossip"):
        Gossip(0, 2).answers([(0, 1, encode([Offer(1, 0)]))])
    with pytest.raises(ProtocolError, match="gossip"):
        Gossip(0, 2).data([(0, 1, 1, b"")])


any_packet = st.one_of(
    st.builds(From, st.integers(0, 255), st.integers(0, 2**24 - 1) | st.integers(0, 4)),
    st.builds(FromEarly, st.integers(0, 4), st.integers(0, 9)),
    st.builds(Held, st.integers(0, 255), st.integers(0, 2**24 - 1) | st.integers(0, 4)),
    st.builds(HeldEarly, st.integers(0, 4), st.integers(0, 9)),
    st.builds(Near, st.integers(0, 255)),
    st.builds(Gone, st.integers(0, 4)),
    st.builds(Offer, st.integers(0, 63), st.integers(0, 63)),
    st.builds(Target, st.integers(0, 2047), st.integers(0, 2047)),
    st.builds(Fragment, st.binary(min_size=1, max_size=9)),
    st.just(Save()),
)
frames = st.lists(any_packet, max_size=6).map(encode) | st.binary(max_size=12)


@given(st.lists(frames, max_size=8), seeds)
def test_a_liar_may_say_anything_and_the_honest_go_on_with_each_other(lies: list[bytes], seed: int) -> None:
    air = Air(3, seed)
    reach = {0: [1, 2], 1: [0, 2]}
    for number, lie in enumerate(lies):
        air.log(0, 1)
        air.log(1, 1)
        for robot in (0, 1):
            mind = air.robot_settings[robot]
            mind.offers(0, list(reach[robot]), None)
            note = Outcome(number, 0, [], [], [], [], [-1], False)
            for peer, map_id, data in mind.outcome(note, [(2, lie)]):
                assert peer == 2
                assert map_id != robot
                assert data
                mind.refused.add((peer, map_id))
        air.step(reach)
    for _ in range(2):
        air.step(reach)
    for map_id in (0, 1):
        assert [len(air.robot_settings[robot].logs[map_id]) for robot in (0, 1)] == 2 * [air.logged[map_id]]


@pytest.mark.parametrize("kind", [Gossip, ConfirmedGossip])
def test_a_liar_who_speaks_of_more_of_a_map_than_there_is_silences_nobody(kind: type[Gossip]) -> None:
    air = Air(3)
    air.robot_settings = [kind(robot, 3) for robot in range(3)]
    lie = encode([HeldEarly(0, 255), FromEarly(0, 0)]) + b"".join(words(0, 0, 200)) + encode([Held(0, 9999)])
    for number in range(1, 9):
        air.log(0, 1)
        mind = air.robot_settings[0]
        assert list(mind.outcome(Outcome(number, 0, [], [], [], [], [-1], False), [(2, lie)])) == []
        assert mind.undelivered() >= 0
        air.step({0: [1, 2], 1: [0, 2]})
        assert len(air.robot_settings[1].logs[0]) == number
