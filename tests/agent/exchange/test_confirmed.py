"""Maps on a medium that loses, delays, repeats and reorders: all arrive, each unit in its place; nobody is fooled."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.exchange.confirmed import ConfirmedSession
from agent.exchange.confirmed_gossip import ConfirmedGossip
from agent.exchange.outcome import Outcome
from protocol import packet_index
from protocol.errors import ProtocolError
from protocol.packets import From, FromEarly, Held, HeldEarly, Offer, decode, encode
from tests.agent.exchange.lossy_link import MAKERS, LossyLink
from tests.agent.exchange.session_link import Reach, everyone, held, line, words

policies = st.sampled_from(sorted(MAKERS))


def level(link: LossyLink) -> bool:
    robots = range(len(link.robot_settings))
    return all(
        held(mind, map_id) == link.recorded(map_id) for mind in link.robot_settings for map_id in robots
    )  # type: ignore[arg-type]


@settings(max_examples=20)
@given(
    policies,
    st.integers(2, 4),
    st.integers(0, 2**16),
    st.sampled_from((0.0, 0.2, 0.5)),
    st.sampled_from((0, 1, 4)),
    st.sampled_from((0.0, 0.4)),
    st.sampled_from((None, 60, 300)),
    st.booleans(),
)
def test_all_maps_reach_all_whatever_happens_on_the_way(
    policy: str,
    robots: int,
    seed: int,
    loss: float,
    delay: int,
    twice: float,
    budget: int | None,
    chain: bool,
) -> None:
    link = LossyLink(policy, robots, seed, loss=loss, delay=delay, twice=twice)
    reach: Reach = line(robots) if chain else everyone(robots)
    for step in range(12):
        link.record(step % robots, 1 + seed % 4)
        link.step(reach, budget)
    for _ in range(40):
        if level(link):
            break
        for _ in range(10):
            link.step(reach, budget)
    assert level(link)


@pytest.mark.parametrize("policy", sorted(MAKERS))
def test_what_nobody_heard_is_not_taken_for_heard(policy: str) -> None:
    link = LossyLink(policy, 2, 0, loss=1.0)
    link.record(0, 30)
    for _ in range(40):
        link.step(everyone(2))
    assert held(link.robot_settings[0], 0) == link.recorded(0), "nothing may be forgotten"  # type: ignore[arg-type]
    assert link.robot_settings[0].undelivered() == 30
    link.loss = 0.0
    for _ in range(80):
        link.step(everyone(2))
    assert level(link)
    assert link.robot_settings[0].undelivered() == 0
    assert link.robot_settings[0].logs[0].oldest == 30, "now that it is confirmed it is forgotten"


@pytest.mark.parametrize("policy", sorted(MAKERS))
def test_robots_that_hold_the_same_fall_silent(policy: str) -> None:
    link = LossyLink(policy, 3, 1, loss=0.2, delay=2)
    for robot in range(3):
        link.record(robot, 10)
    for _ in range(150):
        link.step(everyone(3))
    assert level(link)
    before = link.carried
    for _ in range(40):
        link.step(everyone(3))
    assert link.carried == before


@pytest.mark.parametrize(("policy", "most"), [("backoff", 3.0), ("thesis", 3.0), ("gossip", 4.0)])
def test_a_fifth_of_the_frames_lost_does_not_make_many_times_as_many(policy: str, most: float) -> None:
    said = []
    for loss in (0.0, 0.2):
        link = LossyLink(policy, 3, 5, loss=loss)
        for step in range(300):
            if step < 60:
                link.record(step % 3, 3)
            link.step(everyone(3))
        assert level(link)
        said.append(link.carried)
    assert said[1] < most * said[0]


@pytest.mark.parametrize("policy", sorted(MAKERS))
def test_a_partition_of_a_hundred_steps_is_made_up_for(policy: str) -> None:
    link = LossyLink(policy, 4, 2, loss=0.1)
    apart: Reach = {0: [1], 1: [0], 2: [3], 3: [2]}
    for step in range(120):
        link.record(step % 4, 1)
        link.step(apart if 10 <= step < 110 else everyone(4), 200)
    assert not level(link)
    for _ in range(150):
        link.step(everyone(4), 200)
    assert level(link)


def test_a_unit_is_not_taken_back_once_it_was_on_the_air() -> None:
    for mind in (ConfirmedSession(0, 2), ConfirmedGossip(0, 2)):
        mind.record(words(0, 0, 2))
        assert mind.retract(1)
        mind.record(words(0, 1, 2))
        outcome = Outcome(1, 0, [-1], [0], [0], [0], [], False)
        for round_number in range(4):
            ((_, _, frame),) = mind.offers(round_number, [1], None) or [(0, 0, b"")]
            outcome = Outcome(1, round_number, [-1], [0], [0], [len(frame)], [-1], False)
            list(mind.outcome(outcome, [(1, encode([HeldEarly(0, 0)]))]))
        assert not mind.retract(1), "it was lost perhaps, but perhaps not"


def hear(mind: ConfirmedGossip, peer: int, frame: bytes, nonsense: bytes = b"") -> list[int]:
    """Accept all that is news of a frame but `nonsense`; return of whom that came."""
    heard = Outcome(1, 0, [], [], [], [], [-1], False)
    blamed = []
    for source, map_id, news in mind.outcome(heard, [(peer, frame)]):
        if news == nonsense:
            blamed.append(source)
        else:
            mind.accept(source, map_id, news, packet_index.ends(news))
    return blamed


def test_what_came_too_early_is_kept_until_what_was_lost_comes() -> None:
    mind = ConfirmedGossip(1, 2)
    mind.offers(0, [0], None)
    early = encode([FromEarly(0, 3)]) + b"".join(words(0, 3, 6))
    late = encode([FromEarly(0, 0)]) + b"".join(words(0, 0, 3))
    for frame in (early, late):
        hear(mind, 0, frame)
    assert packet_index.split(mind.logs[0].since(0, None)) == words(0, 0, 6)
    ((_, _, said),) = mind.offers(1, [0], None)
    assert decode(said) == [HeldEarly(0, 6)], "nobody is to say again what was kept"


def test_of_what_was_kept_for_nothing_the_truth_is_taken_when_it_comes() -> None:
    mind = ConfirmedGossip(2, 3)
    mind.offers(0, [0, 1], None)
    lie = words(0, 7, 8)[0]
    first, second = (encode([FromEarly(0, at)]) + words(0, at, at + 1)[0] for at in range(2))
    hear(mind, 1, encode([FromEarly(0, 1)]) + lie, lie)
    assert hear(mind, 0, first, lie) == [1]
    hear(mind, 0, second, lie)
    assert packet_index.split(mind.logs[0].since(0, None)) == words(0, 0, 2)


def test_what_was_kept_of_a_peer_is_not_taken_once_nothing_is_taken_from_it() -> None:
    mind = ConfirmedGossip(2, 3)
    mind.offers(0, [0, 1], None)
    early = encode([FromEarly(0, 1)]) + words(0, 1, 2)[0]
    hear(mind, 1, early)
    mind.refused.add((1, 0))
    hear(mind, 0, encode([FromEarly(0, 0)]) + words(0, 0, 1)[0])
    assert packet_index.split(mind.logs[0].since(0, None)) == words(0, 0, 1)


def test_who_says_to_hold_more_than_there_is_gets_nothing_and_harms_nobody_else() -> None:
    link = LossyLink("backoff", 3, 3)
    link.record(0, 20)
    liar = encode([Held(0, 10_000), HeldEarly(2, 200), Offer(0, 3), From(1, 7), *decode(words(1, 7, 8)[0])])
    for mind in (link.robot_settings[0], link.robot_settings[2]):
        assert list(mind.outcome(Outcome(0, 0, [], [], [], [], [-1], False), [(1, liar)])) == []
    for _ in range(40):
        link.step({0: [2], 2: [0]})
    assert held(link.robot_settings[2], 0) == link.recorded(0)  # type: ignore[arg-type]
    assert link.robot_settings[0].undelivered() == 0


def test_where_only_words_confirm_there_are_no_turns() -> None:
    for mind in (ConfirmedSession(0, 2), ConfirmedGossip(0, 2)):
        with pytest.raises(ProtocolError, match="1 offers"):
            mind.answers([(0, 1, encode([Offer(1, 0)]))])
        with pytest.raises(ProtocolError, match="1 answers"):
            mind.data([(0, 1, 1, b"")])
