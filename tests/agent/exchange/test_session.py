"""The session: logs that reach everyone, whatever the topology and the budget, and never a unit twice."""

from __future__ import annotations

import re
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from agent.exchange import connection as state_table
from agent.exchange.connection import TRANSITIONS, Connection, Event, State
from agent.exchange.handshake import LEAST_HANDSHAKE
from agent.exchange.log import Log
from agent.exchange.offer_policy import CROWD, POLICIES, choose_offers
from agent.exchange.outcome import Outcome
from agent.exchange.session import MAX_WAIT, PATIENCE, Session, reached_by_all
from protocol import packets
from protocol.errors import ProtocolError
from protocol.packets import BLOCKS, INDEX_WINDOW, Answer, Block, Decline, Offer, Save, encode
from tests.agent.exchange.session_link import Link, Played, everyone, held, line, word, words

ROUND = BLOCKS * INDEX_WINDOW
seeds = st.integers(0, 2**32 - 1)
policies = st.sampled_from(POLICIES)


def check(link: Link) -> None:
    """What must hold at any time: logs are what was recorded, and nobody believes too much of another."""
    for session in link.sessions:
        for map_id, log in enumerate(session.logs):
            assert held(session, map_id) == link.recorded(map_id)[: len(log)]
        for peer, other in enumerate(link.sessions):
            if other is not session:
                for map_id, log in enumerate(other.logs):
                    assert session.known[peer][map_id] <= len(log)


def all_equal(link: Link) -> bool:
    lengths = [[len(log) for log in session.logs] for session in link.sessions]
    return all(these == lengths[0] for these in lengths) and sum(lengths[0]) == sum(
        len(link.recorded(robot)) for robot in range(len(link.sessions))
    )


def settle(link: Link, reach: Any, budget: int | None = None, rounds: int = 2, most: int = 400) -> int:
    """Steps until all logs are equal."""
    for step in range(most):
        if all_equal(link):
            return step
        link.step(reach, budget, rounds)
        check(link)
    raise AssertionError(f"not all logs are equal after {most} steps")


@given(st.integers(2, 6), policies, seeds, st.integers(1, 3), st.sampled_from((None, 30, 100, 1000)))
@example(3, "backoff", 0, 1, None)
def test_in_the_end_everyone_holds_everything(
    robots: int, policy: str, seed: int, rounds: int, budget: int | None
) -> None:
    link = Link(robots, policy, seed)
    rng = np.random.default_rng(seed)
    # While robots log, they meet as chance has it; then all stay connected, one by one along a line.
    for _ in range(12):
        for robot in range(robots):
            link.record(robot, int(rng.integers(0, 5)))
        near = np.triu(rng.random((robots, robots)) < 0.4, 1)
        near = near | near.T
        link.step({r: np.flatnonzero(near[r]).tolist() for r in range(robots)}, budget, rounds)
        check(link)
        if rng.random() < 0.3:
            for session in link.sessions:
                session.forget()
    order = rng.permutation(robots).tolist()
    reach = {order[r]: [order[p] for p in peers] for r, peers in line(robots).items()}
    settle(link, reach, budget and max(budget, 100), rounds, most=2000)


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("rounds", [1, 2, 3])
def test_a_map_reaches_robots_out_of_its_makers_range_through_others(policy: str, rounds: int) -> None:
    link = Link(4, policy)
    link.record(0, 30)
    assert settle(link, line(4), None, rounds, most=20) <= 8
    assert held(link.sessions[3], 0) == link.recorded(0)
    assert all(
        offer[0] != 3 for played in link.step(line(4)) for offer in played.connections if offer[2] == 0
    )


@pytest.mark.parametrize("rounds", [1, 2])
def test_maps_of_others_get_through_while_everyone_keeps_logging(rounds: int) -> None:
    link = Link(3)
    for _ in range(20):
        for robot in range(3):
            link.record(robot, 2)
        link.step(line(3), None, rounds)
        check(link)
    assert len(link.sessions[2].logs[0]) >= 30
    assert len(link.sessions[0].logs[2]) >= 30


@given(st.lists(st.integers(0, 60), min_size=1, max_size=60))
def test_what_was_cut_anywhere_goes_on_where_it_stopped(budgets: list[int]) -> None:
    link = Link(2)
    link.record(0, 40)
    for budget in budgets:
        (played, *_) = link.step(everyone(2), budget)
        assert played.carried <= budget
        check(link)
    before = len(link.sessions[1].logs[0])
    settle(link, everyone(2))
    assert held(link.sessions[1], 0) == words(0, 0, 40)
    assert before <= 40


def test_every_cut_between_two_packets_is_a_place_to_go_on() -> None:
    sizes = [len(word(0, number)) for number in range(6)]
    for count in range(7):
        for more in range(sizes[count] if count < 6 else 1):
            link = Link(2)
            link.record(0, 6)
            link.round(0, everyone(2), 4 + sum(sizes[:count]) + more)
            assert len(link.sessions[1].logs[0]) == count
            assert link.sessions[0].known[1][0] == count
            link.round(1, everyone(2))
            assert held(link.sessions[1], 0) == words(0, 0, 6)


def test_what_was_not_put_on_the_air_did_not_happen() -> None:
    for budget in (0, 1, 2, 3, 4):
        link = Link(2)
        link.record(0, 3)
        link.round(0, everyone(2), budget)
        assert len(link.sessions[1].logs[0]) == 0
        assert link.sessions[0].known[1][0] == 0


def test_an_answer_that_was_not_put_on_the_air_moves_nothing() -> None:
    session = Session(0, 2)
    session.record(words(0, 0, 5))
    for number in range(3):
        assert session.offers(0, [1], None), "an answer that nobody heard is no refusal"
        session.data([(number, 1, 0, encode([Answer(3 + number)]))])
        session.outcome(Outcome(0, 0, [number], [2], [0], [0], [], False), [])
        assert session.known[1][0] == 0


def test_who_declines_is_not_forgotten_to_hold_what_he_was_sent() -> None:
    link = Link(2, "thesis")
    link.record(0, 4)
    link.round(0, everyone(2))
    session: Any = link.sessions[1]
    session.answers = lambda heard: [(number, peer, encode([Decline()])) for number, peer, _ in heard]
    link.record(0, 1)
    link.round(0, everyone(2))
    assert link.sessions[0].known[1][0] == 4


def test_only_what_the_other_lacks_is_sent() -> None:
    link = Link(2, "thesis")
    link.record(0, 10)
    link.round(0, everyone(2))
    link.record(0, 2)
    played = link.round(0, everyone(2))
    assert played.data == len(word(0, 10) + word(0, 11))
    assert link.round(0, everyone(2)).carried == 0


def test_of_two_who_offer_one_map_the_first_sends_and_the_other_is_declined() -> None:
    link = Link(3, "thesis", seed=4)
    link.record(0, 5)
    link.round(0, {0: [1], 1: [0], 2: []})
    played = link.round(1, {0: [2], 1: [2], 2: [0, 1]})
    assert sorted(carried[2] > 0 for *_, carried in played.connections) == [False, True]
    assert [carried[:2] for *_, carried in played.connections] == [[2, 2], [2, 2]]
    assert held(link.sessions[2], 0) == words(0, 0, 5)


def test_nobody_is_offered_his_own_map_or_what_he_is_known_to_hold() -> None:
    link = Link(3, "thesis")
    for robot in range(3):
        link.record(robot, 4)
    for _ in range(4):
        for sender, receiver, map_id, _ in link.round(1, everyone(3)).connections:
            assert map_id != receiver
            assert sender != receiver
    assert link.round(1, everyone(3)).carried == 0


@given(st.integers(2, 5), seeds)
def test_who_backs_off_wastes_fewer_handshakes_than_the_thesis(robots: int, seed: int) -> None:
    spent = {}
    for policy in POLICIES:
        link = Link(robots, policy, seed)
        handshakes = 0
        for _ in range(15):
            for robot in range(robots):
                link.record(robot, 1)
            for played in link.step(everyone(robots)):
                handshakes += played.offers + played.answers
        spent[policy] = handshakes
        settle(link, everyone(robots))
    assert spent["backoff"] <= spent["thesis"]


def refusals(link: Link, rounds: int) -> list[int]:
    """Exchanges in which robot 0 offers robot 1 the map of robot 2, and is refused."""
    found = []
    for number in range(rounds):
        played = link.round(1, {0: [1], 1: [0]})
        if any(connection[:3] == (0, 1, 2) for connection in played.connections):
            found.append(number)
    return found


def test_after_each_refusal_the_next_offer_waits_twice_as_long() -> None:
    link = Link(3)
    link.record(2, 1)
    link.round(1, {0: [2], 2: [0]})
    # Robot 1 takes part, but somebody else is always sending this map to it.
    session: Any = link.sessions[1]
    session.answers = lambda heard: [(number, peer, encode([Decline()])) for number, peer, _ in heard]
    offered = refusals(link, 4 * MAX_WAIT)
    gaps = [b - a for a, b in pairwise(offered)]
    assert gaps[:7] == [1, 2, 4, 8, 16, 32, MAX_WAIT]
    assert set(gaps[7:]) == {MAX_WAIT}


def test_who_was_taken_up_again_no_longer_waits() -> None:
    link = Link(3)
    link.record(2, 1)
    link.round(1, {0: [2], 2: [0]})
    session: Any = link.sessions[1]
    answers = session.answers
    session.answers = lambda heard: [(number, peer, encode([Decline()])) for number, peer, _ in heard]
    refusals(link, 8)
    session.answers = answers
    refusals(link, 8)
    assert len(link.sessions[1].logs[2]) == 1
    for count in range(2, 6):
        link.record(2, 1)
        link.round(1, {0: [2], 2: [0]})
        link.round(1, {0: [1], 1: [0]})
        assert len(link.sessions[1].logs[2]) == count
    link.record(2, 1)
    link.round(1, {0: [2], 2: [0]})
    session.answers = lambda heard: [(number, peer, encode([Decline()])) for number, peer, _ in heard]
    offered = refusals(link, 8)
    assert [b - a for a, b in pairwise(offered)][:3] == [1, 2, 4]


# Long logs: an answer's index is never guessed at.


def with_logs(*lengths: int) -> Link:
    """Robots of which each holds so much of robot 0's log, and none knows anything of another."""
    link = Link(len(lengths), "thesis")
    whole = words(0, 0, max(lengths))
    link._recorded[0] = max(lengths)
    for session, length in zip(link.sessions, lengths, strict=True):
        session.logs[0].append(whole[:length])
    return link


PLACES = [0, 1, INDEX_WINDOW - 1, INDEX_WINDOW, INDEX_WINDOW + 1, 3 * INDEX_WINDOW + 5]


@pytest.mark.parametrize("table", PLACES)
@pytest.mark.parametrize("mine", PLACES)
@pytest.mark.parametrize("theirs", PLACES)
def test_an_index_in_another_block_is_understood(mine: int, theirs: int, table: int) -> None:
    link = with_logs(mine, theirs)
    link.sessions[0].known[1][0] = min(table, mine, theirs)
    link.round(0, everyone(2))
    assert len(link.sessions[1].logs[0]) == max(mine, theirs)
    assert link.sessions[0].known[1][0] == mine
    assert held(link.sessions[1], 0)[-3:] == words(0, 0, max(mine, theirs))[-3:]


@pytest.mark.parametrize(
    ("there", "packets_"), [(0, 1), (INDEX_WINDOW - 1, 1), (INDEX_WINDOW, 2), (ROUND, 3)]
)
def test_an_answer_is_as_short_as_it_can_be(there: int, packets_: int) -> None:
    session = Session(1, 2)
    session.logs[0] = _Long(there)
    ((_, _, frame),) = session.answers([(0, 0, encode([Offer(0, 0)]))])
    assert len(packets.decode(frame)) == packets_
    assert len(frame) == 2 * packets_


class _Long(Log):
    """A log that says to be long."""

    def __init__(self, length: int) -> None:
        super().__init__()
        self._forgotten = length


LATE = [
    (ROUND + 20, 0, 0),
    (ROUND + 20, ROUND + 5, 0),
    (ROUND + 20, ROUND - 1, 0),
    (ROUND + INDEX_WINDOW + 20, ROUND + 5, 0),
    (2 * ROUND + 7, ROUND + 3, 3),
    (2 * ROUND + 7, 12, 12),
    (3 * ROUND, 3 * ROUND - 1, 5),
    (ROUND + 20, ROUND + 5, ROUND + 1),
    (ROUND + 20, ROUND + 5, ROUND - 1),
]


@pytest.mark.parametrize(("mine", "theirs", "table"), LATE)
def test_logs_of_many_rounds_of_blocks_do_not_mix_up_their_units(mine: int, theirs: int, table: int) -> None:
    """A peer that got far ahead of the table, through others, goes on exactly where it is."""
    offerer, peer = Session(0, 3), Session(1, 3)
    unit = encode([Save()])
    offerer.logs[2].append(mine * [unit])
    peer.logs[2].append(theirs * [unit])
    offerer.known[1][2] = table
    ((_, _, offer),) = offerer.offers(1, [1], 1000)
    ((_, _, answer),) = peer.answers([(0, 0, offer)])
    ((_, _, data),) = offerer.data([(0, 1, 2, answer)])
    assert len(data) == min(mine - theirs, 1000)
    offerer.outcome(Outcome(0, 1, [0], [2], [len(answer)], [len(data)], [], False), [])
    assert offerer.known[1][2] == theirs + len(data)


# Forgetting.


def test_what_all_hold_is_forgotten_and_nothing_else() -> None:
    link = Link(3, "thesis")
    for robot in range(3):
        link.record(robot, 10)
    for _ in range(6):
        link.step(everyone(3))
        for session in link.sessions:
            session.forget()
        check(link)
    assert all(log.oldest == 10 for session in link.sessions for log in session.logs)
    link.record(0, 3)
    settle(link, everyone(3))


def test_what_one_lacks_is_remembered() -> None:
    link = Link(3, "thesis")
    link.record(0, 10)
    for _ in range(5):
        link.step({0: [1], 1: [0], 2: []})
        for session in link.sessions:
            session.forget()
    assert [session.logs[0].oldest for session in link.sessions[:2]] == [0, 0]
    assert settle(link, {0: [], 1: [2], 2: [1]}) < 5


def test_the_maker_of_a_map_need_not_be_told_that_he_holds_it() -> None:
    link = Link(3, "thesis")
    link.record(0, 10)
    link.step({0: [1], 1: [0], 2: []})
    for _ in range(3):
        link.step({0: [], 1: [2], 2: [1]})
    for session in link.sessions[1:]:
        session.forget()
        assert session.logs[0].oldest == 10


def test_a_robot_alone_forgets_what_it_logged() -> None:
    session = Session(0, 1)
    session.record(words(0, 0, 5))
    session.forget()
    assert (len(session.logs[0]), session.logs[0].oldest) == (5, 5)


@given(st.lists(st.integers(1, 30), max_size=12), st.data())
def test_a_log_gives_what_fits_from_where_it_is_asked(sizes: list[int], data: st.DataObject) -> None:
    log = Log()
    units = [bytes([number]) * size for number, size in enumerate(sizes)]
    log.append(units)
    log.forget(data.draw(st.integers(0, len(units) + 3)))
    begin = data.draw(st.integers(log.oldest, len(units)))
    room = data.draw(st.none() | st.integers(0, 200))
    got = log.since(begin, room)
    end = log.reached(begin, len(got))
    assert len(log) == len(units)
    assert got == b"".join(units[begin:end])
    if room is None:
        assert end == len(units)
    else:
        assert len(got) <= room
        assert end == len(units) or len(got) + sizes[end] > room
    until = data.draw(st.integers(begin, len(units)))
    assert log.since(begin, room, until) == b"".join(units[begin : min(until, end)])


@given(st.lists(st.integers(1, 9), min_size=1, max_size=12), st.data())
def test_units_are_taken_back_unless_they_have_been_heard(sizes: list[int], data: st.DataObject) -> None:
    log = Log()
    units = [bytes([number]) * size for number, size in enumerate(sizes)]
    log.append(units)
    log.forget(data.draw(st.integers(0, len(units) - 1)))
    count = data.draw(st.integers(0, len(units) - log.oldest))
    heard = data.draw(st.integers(log.oldest, len(units)))
    left = len(units) - count if len(units) - count >= heard else len(units)
    assert log.retract(count, heard) == (len(units) - count >= heard)
    log.append(units)
    assert log.since(log.oldest, None) == b"".join(units[log.oldest : left] + units)
    assert len(log) == left + len(units)


# The tables, against the rules read line by line.


@st.composite
def tables(draw: st.DrawFn) -> tuple[int, np.random.Generator, Any, Any, Any]:
    """How many robots there are, and what one of them knows: of the peers, when offers are due, its logs."""
    robots, rng = draw(st.integers(2, 9)), np.random.default_rng(draw(seeds))
    known = rng.integers(0, 4, (robots, robots))
    due = rng.integers(0, 6, (robots, robots))
    return robots, rng, known, due, rng.integers(0, 6, robots)


def offered_by_the_rule(
    robot: int, peer: int, known: Any, due: Any, held: Any, now: int, round_number: int, only_first: bool
) -> int:
    own = held[robot] > known[peer][robot] and now >= due[peer][robot]
    if own and not only_first:
        return robot
    if round_number == 0 and not (only_first and now % 2 == 0):
        return robot if own else -1
    others = [
        map_id
        for map_id in range(len(held))
        if map_id not in (robot, peer) and held[map_id] > known[peer][map_id] and now >= due[peer][map_id]
    ]
    if others:
        return max(others, key=lambda map_id: held[map_id] - known[peer][map_id])
    return robot if own else -1


@given(tables(), st.integers(0, 1), st.integers(1, 6), st.booleans())
def test_what_is_offered_is_what_the_rule_says(
    team: Any, round_number: int, now: int, only_first: bool
) -> None:
    robots, rng, known, due, held = team
    robot = int(rng.integers(robots))
    peers = np.array([peer for peer in range(robots) if peer != robot], np.int64)
    chosen = np.empty(len(peers), np.int64)
    choose_offers(
        known, due, held, peers, np.arange(len(known)), robot, now, round_number, only_first, chosen
    )
    wanted = [
        offered_by_the_rule(robot, peer, known, due, held, now, round_number, only_first)
        for peer in peers.tolist()
    ]
    assert chosen.tolist() == wanted


@given(tables())
def test_what_all_hold_is_the_least_that_any_other_holds(team: Any) -> None:
    robots, rng, known, _, _ = team
    robot = int(rng.integers(robots))
    reached = np.empty(robots, np.int64)
    reached_by_all(known, robot, reached)
    for map_id in range(robots):
        others = [known[peer][map_id] for peer in range(robots) if peer not in (robot, map_id)]
        assert reached[map_id] == min(others, default=np.iinfo(np.int64).max)


# Crowds: handshakes grow with the square of the team, the medium does not.


@given(st.integers(2, 40), st.none() | st.integers(0, 3000), policies)
def test_a_crowd_makes_no_more_offers_than_the_medium_could_carry_answers_of(
    robots: int, room: int | None, policy: str
) -> None:
    link = Link(robots, policy)
    for robot in range(robots):
        link.record(robot, 1)
    made = [session.offers(0, everyone(robots)[n], room) for n, session in enumerate(link.sessions)]
    assert all(len({peer for peer, _, _ in offers}) == len(offers) for offers in made)
    if policy == "thesis" or room is None or robots <= CROWD:
        assert all(len(offers) == robots - 1 for offers in made)
    else:
        assert all(
            len(offers) == min(robots - 1, max(1, room // LEAST_HANDSHAKE // robots)) for offers in made
        )
        assert sum(map(len, made)) * LEAST_HANDSHAKE <= max(room, robots * LEAST_HANDSHAKE)


def test_in_a_crowd_everyone_s_turn_comes() -> None:
    robots, room = 30, 400
    session = Session(7, robots)
    session.record(words(7, 0, 1))
    offered: list[int] = []
    while len(offered) < robots - 1:
        offered += [peer for peer, _, _ in session.offers(0, everyone(robots)[7], room)]
    assert offered[: robots - 1] == [*range(8, robots), *range(7)]


def test_a_crowd_s_maps_reach_everyone_all_the_same() -> None:
    robots = CROWD + 4
    link = Link(robots, seed=1)
    for robot in range(robots):
        link.record(robot, 3)
    for _ in range(400):
        link.step(everyone(robots), 500)
        if all(len(log) == 3 for session in link.sessions for log in session.logs):
            break
    assert all(
        held(session, map_id) == link.recorded(map_id)
        for session in link.sessions
        for map_id in range(robots)
    )


# Liars. The relay has checked the form of their frames, not their sense.


class Liar(Session):
    """Offers, answers and sends whatever has the right form."""

    def __init__(self, robot: int, robots: int, seed: int) -> None:
        super().__init__(robot, robots)
        self._rng = np.random.default_rng([seed, robot])
        self._me = robot

    def offers(self, _round: int, peers: list[int], _room: int | None) -> list[tuple[int, int, bytes]]:
        return [
            (peer, map_id, encode([Offer(map_id, int(self._rng.integers(BLOCKS)))]))
            for peer in peers
            for map_id in self._rng.integers(0, len(self.logs), self._rng.integers(0, 3)).tolist()
        ]

    def answers(self, heard: list[tuple[int, int, bytes]]) -> list[tuple[int, int, bytes]]:
        said = []
        for number, peer, _ in heard:
            index, block = (
                Answer(int(self._rng.integers(INDEX_WINDOW))),
                Block(int(self._rng.integers(BLOCKS))),
            )
            choices: list[list[packets.Packet]] = [
                [index],
                [block, index],
                [block, block, index],
                [Decline()],
            ]
            if self._rng.random() < 0.9:
                said.append((number, peer, encode(choices[self._rng.integers(4)])))
        return said

    def data(self, heard: list[tuple[int, int, int, bytes]]) -> list[tuple[int, int, bytes]]:
        noise = [words(map_id, int(self._rng.integers(9)), 9) for _, _, map_id, _ in heard]
        return [
            (n, peer, b"".join(said) + encode([Save()]))
            for (n, peer, *_), said in zip(heard, noise, strict=True)
        ]

    def outcome(
        self, _outcome: Outcome, _heard: list[tuple[int, bytes]]
    ) -> list[tuple[int, int, list[bytes]]]:
        return []

    def forget(self) -> None:
        pass


@settings(max_examples=max(8, settings.default.max_examples // 4))
@given(st.integers(3, 5), policies, seeds)
def test_who_lies_neither_spoils_a_log_nor_keeps_others_from_theirs(
    robots: int, policy: str, seed: int
) -> None:
    link = Link(robots, policy, seed)
    liar = robots - 1
    link.sessions[liar] = Liar(liar, robots, seed)
    honest = range(liar)
    for _ in range(150):
        for robot in honest:
            if sum(map(len, link.sessions[robot].logs)) < 40:
                link.record(robot, 1)
        link.step(everyone(robots), 500)
        for robot in honest:
            link.sessions[robot].forget()
            for map_id in honest:
                log = held(link.sessions[robot], map_id)
                assert log == link.recorded(map_id)[: len(log)]
            assert held(link.sessions[robot], robot) == link.recorded(robot)
    for robot in honest:
        for map_id in honest:
            assert held(link.sessions[robot], map_id) == link.recorded(map_id)


def test_nobody_takes_news_of_himself() -> None:
    session = Session(0, 3)
    session.record(words(0, 0, 2))
    ((_, _, answer),) = session.answers([(5, 1, encode([Offer(0, 0)]))])
    assert packets.decode(answer) == [Decline()]
    assert session.outcome(Outcome(0, 0, [5], [2], [2], [9], [5], False), [(1, word(0, 2))]) == []
    assert held(session, 0) == words(0, 0, 2)


def test_data_on_a_connection_that_was_declined_or_never_offered_is_dropped() -> None:
    session = Session(0, 3)
    offer = encode([Offer(2, 0)])
    answers = session.answers([(5, 1, offer), (6, 2, offer)])
    assert [packets.decode(frame) for _, _, frame in answers] == [[Answer(0)], [Decline()]]
    outcome = Outcome(0, 0, [5, 6], [2, 2], [2, 2], [7, 7], [5, 6, 99], False)
    news = session.outcome(outcome, [(1, word(2, 0)), (2, word(2, 0)), (2, word(2, 0))])
    assert news == [(1, 2, word(2, 0))]


@pytest.mark.parametrize(
    "frame", [b"", b"\xff", encode([Answer(0)]), encode([Offer(3, 0)]), 2 * encode([Offer(1, 0)]), b"\xc0"]
)
def test_an_offer_that_is_none_is_refused(frame: bytes) -> None:
    with pytest.raises(ProtocolError):
        Session(0, 3).answers([(0, 1, frame)])


@pytest.mark.parametrize(
    "frame",
    [
        b"",
        b"\xff",
        encode([Offer(0, 0)]),
        encode([Block(0)]),
        encode([Answer(0), Block(0)]),
        2 * encode([Answer(0)]),
        3 * encode([Block(0)]),
        encode([Block(0), Decline()]),
        encode([Save()]),
    ],
)
def test_an_answer_that_is_none_is_refused(frame: bytes) -> None:
    session = Session(0, 3)
    session.record(words(0, 0, 2))
    assert session.offers(0, [1], None)
    with pytest.raises(ProtocolError):
        session.data([(0, 1, 0, frame)])


def test_an_answer_to_an_offer_that_was_not_made_is_refused() -> None:
    session = Session(0, 3)
    session.record(words(0, 0, 2))
    session.offers(0, [1], None)
    for peer, map_id in ((2, 0), (1, 1)):
        with pytest.raises(ProtocolError, match=f"robot {peer} answers an offer that was not made"):
            session.data([(0, peer, map_id, encode([Answer(0)]))])


@pytest.mark.parametrize("index", [2, 3, 4095])
def test_a_peer_that_says_to_hold_as_much_or_more_is_sent_nothing(index: int) -> None:
    session = Session(0, 2)
    session.record(words(0, 0, 2))
    session.offers(0, [1], None)
    assert session.data([(0, 1, 0, encode([Answer(index)]))]) == []
    session.outcome(Outcome(0, 0, [0], [2], [2], [0], [], False), [])
    assert session.known[1][0] == 2
    assert session.delivered()


def test_a_peer_that_says_to_hold_less_than_it_was_sent_is_not_sent_it_again() -> None:
    link = Link(2, "thesis")
    link.record(0, 9)
    link.round(0, everyone(2))
    session: Any = link.sessions[1]
    session.answers = lambda heard: [(number, peer, encode([Answer(0)])) for number, peer, _ in heard]
    link.record(0, 1)
    assert link.round(0, everyone(2)).data == 0
    assert link.round(0, everyone(2)).carried == 0


# Small print.


WORDS_OF_THE_TABLE = {
    "medium opens, there is news": Event.NEWS,
    "answer, index below my own": Event.BEHIND,
    "answer, index not below": Event.LEVEL,
    "decline": Event.DECLINED,
    "offer, first of its map": Event.FIRST_OFFER,
    "offer, another of that map": Event.UNWANTED_OFFER,
    "offer of the receiver's map": Event.UNWANTED_OFFER,
    "offer of one who is distrusted": Event.UNWANTED_OFFER,
}


def test_the_table_of_states_is_the_one_in_the_first_lines_of_the_file() -> None:
    rows = re.findall(
        r"^    (?:offerer|receiver) +(\w+) +(.*?) +(\w+) +say ", state_table.__doc__ or "", re.M
    )
    table = {(State(before), WORDS_OF_THE_TABLE[event]): State(after) for before, event, after in rows}
    assert len(rows) == len(WORDS_OF_THE_TABLE)
    assert table == TRANSITIONS
    with pytest.raises(KeyError):
        Connection(1, 1, State.REFUSED).on(Event.NEWS)


def test_who_refuses_again_and_again_is_not_waited_for() -> None:
    link = Link(3)
    link.record(0, 1)
    stubborn: Any = link.sessions[1]
    stubborn.answers = lambda heard: [(number, peer, encode([Decline()])) for number, peer, _ in heard]
    waited = 0
    while not link.sessions[0].delivered():
        link.step(everyone(3))
        waited += 1
    assert 1 < waited <= 2 * PATIENCE
    link.record(0, 1)
    assert not link.sessions[0].delivered(), "robot 2 is waited for"
    link.step(everyone(3))
    assert link.sessions[0].delivered()
    assert len(link.sessions[2].logs[0]) == 2


def test_offers_of_who_is_refused_leave_the_place_to_others() -> None:
    link = Link(3)
    link.record(2, 1)
    link.round(1, {0: [2], 2: [0]})
    link.sessions[1].refused.add((0, 2))
    for _ in range(4):
        link.round(1, {0: [1], 1: [0]})
    assert len(link.sessions[1].logs[2]) == 0
    link.round(1, everyone(3))
    assert len(link.sessions[1].logs[2]) == 1


def test_what_all_in_range_hold_counts_as_delivered() -> None:
    link = Link(3)
    link.record(0, 2)
    assert not link.sessions[0].delivered()
    link.step({0: [1], 1: [0], 2: []})
    assert link.sessions[0].delivered()
    assert link.sessions[0].undelivered() == 2
    link.step(everyone(3))
    assert link.sessions[0].undelivered() == 0
    link.record(0, 1)
    assert not link.sessions[0].delivered()


def test_an_unknown_policy_is_refused_with_those_there_are() -> None:
    with pytest.raises(ValueError, match=r"'often'; there are: backoff, thesis"):
        Session(0, 2, "often")


def test_a_robot_offers_at_most_one_map_to_each_teammate_and_exchange() -> None:
    link = Link(4)
    for robot in range(4):
        link.record(robot, 3)
    for number in range(6):
        played: Played = link.round(number % 2, everyone(4))
        pairs = [connection[:2] for connection in played.connections]
        assert len(set(pairs)) == len(pairs)
