"""Gossip: each entry is broadcast once where that is enough, by one robot, to the peers that can use it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.encodings.base import Dependency
from agent.replication.delivery import PATIENCE
from agent.replication.gossip_policy import HELD_PER_PRIORITY, MAX_PRIORITY
from agent.replication.neighbors import GREETING
from agent.replication.reports import REFRESH
from protocol import packet_codec, packet_index
from protocol.packet_codec import encode
from protocol.packets import (
    GOSSIP_WINDOW,
    Delete,
    Fragment,
    From,
    FromFirst,
    Gone,
    Held,
    HeldFirst,
    LogDigest,
    Near,
    Offer,
    Save,
    Target,
)
from tests.agent.replication.network import (
    Network,
    closing,
    engine,
    entries,
    entry,
    everyone,
    line,
    make_engine,
    random_reach,
)

seeds = st.integers(0, 2**32 - 1)
APART = {0: [1], 1: [0], 2: []}


def broadcasts(network: Network) -> dict[int, bytes]:
    """What each robot had on the air in the last round."""
    return {each.sender: each.frames[0][: each.carried[0]] for each in network.last if each.carried[0]}


def step(network: Network, reach: object, budget: int | None = None, rounds: int = 1) -> None:
    network.step(reach, budget, rounds)  # type: ignore[arg-type]
    network.check()


def gossip(robots: int, seed: int = 0) -> Network:
    return Network(robots, "gossip", seed)


@given(st.integers(2, 6), seeds)
def test_robots_in_range_of_each_other_send_each_entry_once_and_nothing_else(robots: int, seed: int) -> None:
    network = gossip(robots, seed)
    size = 0
    for _ in range(6):
        for robot in range(robots):
            count = int(network.rng.integers(0, 4))
            size += sum(map(len, entries(robot, network.appended[robot], network.appended[robot] + count)))
            network.append(robot, count)
        step(network, everyone(robots))
        assert network.complete()
    assert network.carried == size


@pytest.mark.slow
@given(st.integers(2, 5), seeds, st.integers(15, 60))
def test_a_narrow_medium_cuts_between_entries_and_no_entry_is_sent_twice(
    robots: int, seed: int, budget: int
) -> None:
    network = gossip(robots, seed)
    for robot in range(robots):
        network.append(robot, int(network.rng.integers(0, 12)))
    for _ in range(20 * robots):
        step(network, everyone(robots), budget)
    assert network.complete()
    assert network.carried == sum(sum(map(len, network.written(robot))) for robot in range(robots))


@given(st.integers(2, 6), seeds, st.sampled_from((None, 40, 200)), st.floats(0.1, 0.9))
def test_logs_agree_once_all_robots_are_together(
    robots: int, seed: int, budget: int | None, chance: float
) -> None:
    network = gossip(robots, seed)
    for _ in range(12):
        for robot in range(robots):
            network.append(robot, int(network.rng.integers(0, 3)))
        step(network, random_reach(network.rng, robots, chance), budget, rounds=2)
    network.settle(everyone(robots), budget, 1, most=REFRESH * robots * 8)


@given(st.integers(3, 6), seeds)
def test_along_a_chain_entries_reach_both_ends(robots: int, seed: int) -> None:
    network = gossip(robots, seed)
    for _ in range(8):
        for robot in range(robots):
            network.append(robot, int(network.rng.integers(0, 3)))
        step(network, line(robots))
    network.settle(line(robots), None, 1, most=REFRESH * robots * 4)


def test_two_halves_that_meet_exchange_their_logs_almost_without_repetition() -> None:
    network = gossip(4)
    for _ in range(10):
        for robot in range(4):
            network.append(robot, 1)
        step(network, {0: [1], 1: [0], 2: [3], 3: [2]})
    assert not network.complete()
    before = network.carried
    for _ in range(PATIENCE):
        step(network, everyone(4))
    assert network.complete()
    assert network.carried - before < 2.5 * sum(sum(map(len, network.written(robot))) for robot in range(4))


def test_entries_of_a_dead_robot_reach_all_from_the_one_that_received_them() -> None:
    network = gossip(4)
    network.append(3, 5)
    step(network, {0: [], 1: [], 2: [3], 3: [2]})
    for _ in range(PATIENCE * 4):
        step(network, {0: [1], 1: [0, 2], 2: [1]})
    assert [network.length(robot, 3) for robot in range(3)] == [5, 5, 5]


def test_of_several_robots_that_could_forward_a_map_one_does() -> None:
    network = gossip(5)
    network.append(0, 4)
    step(network, {0: [1, 2, 3], 1: [0, 2, 3], 2: [0, 1, 3], 3: [0, 1, 2], 4: []})
    forwarders: list[int] = []
    for _ in range(GREETING + 3):
        step(network, {1: [2, 3, 4], 2: [1, 3, 4], 3: [1, 2, 4], 4: [1, 2, 3]})
        forwarders += [
            robot for robot, frame in broadcasts(network).items() if encode([FromFirst(0, 0)]) in frame
        ]
    assert network.length(4, 0) == 4
    assert len(forwarders) == 1


@given(seeds)
def test_entries_follow_those_that_they_depend_on(seed: int) -> None:
    rng = np.random.default_rng(seed)
    network, sizes = gossip(3, seed), (12, 9, 0)
    dependencies: dict[int, list[Dependency]] = {0: [], 1: []}
    network.engines[0] = make_engine(
        0,
        3,
        lambda *received: packet_index.ends(received[-1]),
        "gossip",
        dependencies=lambda number: dependencies.get(number, []),
    )
    for robot, count in enumerate(sizes):
        network.append(robot, count)
    step(network, APART)
    held = [0, 0]
    for of in rng.permutation(
        [0] * 4 + [1] * 3
    ).tolist():  # written in this order, each on all others by then
        first, other = held[of], 1 - of
        dependencies[of].append(Dependency(first, first + 3, ((other, held[other]),)))
        held[of] += 3
    for _ in range(40):
        step(network, {0: [2], 1: [], 2: [0]}, 40)
        for of in (0, 1):
            for each in dependencies[of]:
                if each.first < network.length(2, of):
                    assert all(network.length(2, other) >= length for other, length in each.requires)
    assert [network.length(2, of) for of in range(3)] == list(sizes)


def test_a_header_precedes_entries_only_where_a_receiver_may_have_missed_the_last_ones() -> None:
    network = gossip(3)
    network.append(0, 1)
    step(network, APART)
    assert broadcasts(network)[0] == encode([Gone(2)]) + entry(0, 0)
    assert broadcasts(network)[1].startswith(encode([Gone(2)]))
    network.append(0, 1)
    step(network, APART)
    assert not [each for each in packet_codec.decode(broadcasts(network)[0]) if isinstance(each, From)]
    assert entry(0, 1) in broadcasts(network)[0]
    network.append(0, 1)
    step(network, everyone(3))
    assert encode([FromFirst(0, 2)]) + entry(0, 2) in broadcasts(network)[0]
    for _ in range(GREETING + 2):
        step(network, everyone(3))
    assert network.length(2, 0) == 3


def test_robots_that_meet_report_the_logs_that_grew_since() -> None:
    network = gossip(3)
    for robot in range(3):
        network.append(robot, 2)
    step(network, everyone(3))
    network.append(2, 1)
    step(network, {0: [], 1: [2], 2: [1]})
    step(network, everyone(3))
    reports = {
        (robot, packet)
        for robot, frame in broadcasts(network).items()
        for packet in packet_codec.decode(frame)
        if isinstance(packet, Held)
    }
    assert (1, HeldFirst(2, 3)) in reports
    assert not [packet for robot, packet in reports if packet.map in (0, 1) and robot != 0]


def test_a_log_is_delivered_once_it_was_on_the_air_with_a_peer_in_range() -> None:
    network = gossip(2)
    maker = network.engines[0]
    assert not maker.delivered()
    step(network, everyone(2))
    assert maker.delivered()
    network.append(0, 2)
    step(network, everyone(2), len(entry(0, 0)))
    assert not maker.delivered()
    assert maker.undelivered() == 1
    assert not maker.own_log.retract(2)
    assert maker.own_log.retract(1)
    network.appended[0] -= 1
    network.append(0, 1)
    step(network, everyone(2))
    assert maker.delivered()
    step(network, {0: [], 1: []})
    assert not maker.delivered()


@pytest.mark.parametrize("cut", range(10))
def test_packets_of_a_frame_that_were_not_on_the_air_are_sent_again_and_no_others(cut: int) -> None:
    """Robots 2 and 3 are out of range; robot 1, which has come into range, is to receive a report, too."""
    each = engine(0, 4)
    each.open_round(0, [], None)
    each.own_log.append(entries(0, 0, 2))
    each.logs[2].append(entries(2, 0, 2))
    for _ in range(GREETING + 2):
        (frame,) = each.open_round(0, [1], None)
    reports = encode([Gone(2), Gone(3), HeldFirst(2, 2)])
    own, others = b"".join(entries(0, 0, 2)), b"".join(entries(2, 0, 2))
    headers = [encode([FromFirst(of, 0)]) for of in (0, 2)]
    assert frame.payload == reports + headers[0] + own + headers[1] + others
    size = [0, *packet_index.ends(frame.payload)][cut]
    each.close_round(closing(sent=size))
    assert each.own_log.shared == [0, 0, 0, 0, 0, 1, 2, 2, 2, 2][cut]
    again = b"".join(frame.payload for frame in each.open_round(0, [1], None))
    assert [part for part in packet_codec.decode(again) if not isinstance(part, From)] == [
        part for part in packet_codec.decode(frame.payload[size:]) if not isinstance(part, From)
    ]


def test_a_packet_that_does_not_fit_is_left_out_and_a_shorter_one_still_goes() -> None:
    gone, digest, report = 2, LogDigest.size, 2
    for budget, sizes in (
        (gone + digest + report, [gone, digest, report]),
        (digest, [gone, report]),
        (1, []),
    ):
        each = engine(0, 3)
        each.salt = 7
        each.open_round(0, [], None)
        each.own_log.append(entries(0, 0, 1))
        each.own_log.sent(1)
        each.own_log.request_digest(1)
        each.logs[2].append(entries(2, 0, 1))
        payload = b"".join(frame.payload for frame in each.open_round(0, [1], budget))
        assert [len(packet) for packet in packet_index.split(payload)] == sizes


def test_an_unfinished_append_has_the_highest_priority_and_waiting_raises_it() -> None:
    each = engine(0, 2)
    each.own_log.append(entries(0, 0, 2))
    priorities = []
    for carried in (0, 0, len(entry(0, 0))):
        each.open_round(0, [1], 100)
        priorities.append(each.priority)
        assert not each.close_round(closing(sent=carried))
    assert 0 < priorities[0] < priorities[1] < priorities[2] < MAX_PRIORITY
    each.open_round(0, [1], 100)
    assert each.priority == MAX_PRIORITY


def test_with_an_urgency_it_ranks_frames_times_the_steps_that_they_waited() -> None:
    """A step's later rounds, whose budget is too small, do not count as a step without anything to send."""
    priorities = []
    for urgency in (0.0, 3.5):
        each = engine(0, 2)
        each.urgency = urgency
        each.open_round(0, [1], 100)
        each.own_log.append(entries(0, 0, 2))
        for _ in range(3):
            each.open_round(0, [1], 100)
            priorities.append(each.priority)
            each.open_round(1, [1], 1)
    assert priorities == [2, 3, 4, 7, 10, 14]
    each.urgency = 1e9
    each.open_round(0, [1], 100)
    assert each.priority == MAX_PRIORITY - 1


def test_once_robots_were_apart_serving_a_peer_that_holds_more_has_priority() -> None:
    known, priorities = 400, []
    for held in (known, 0):
        each = engine(0, 3)
        each.open_round(0, [1], 100)  # robot 2 is away
        each.logs[1].append(entries(1, 0, known))
        each.peers.expected[2, 1] = held
        each.own_log.append(entries(0, 0, 1))
        for _ in range(GREETING + 2):
            each.open_round(0, [2], 100)
        priorities.append(each.priority)
    assert priorities[0] == priorities[1] + known // HELD_PER_PRIORITY < MAX_PRIORITY


@pytest.mark.slow
def test_offsets_modulo_the_window_mean_the_value_nearest_to_the_receiver_s_log() -> None:
    each = engine(1, 2)
    for _ in range(16):
        each.logs[0].append([encode([Save()])] * (GOSSIP_WINDOW // 16))
    each.logs[0].append([encode([Save()])] * 5)
    each.open_round(0, [0], None)
    assert not each.close_round(closing((0, encode([From(0, 5), Delete(1), Save()]))))
    assert each.logs[0].read(GOSSIP_WINDOW + 5, None) == encode([Delete(1), Save()])


def test_peers_that_keep_up_receive_new_entries_before_others_receive_old_ones() -> None:
    network = gossip(3)
    for _ in range(10):
        network.append(0, 1)
        step(network, APART)
    for _ in range(GREETING + 1):
        step(network, everyone(3))
    network.append(0, 1)
    step(network, everyone(3), 40)
    assert network.length(1, 0) == 11
    for _ in range(20):
        step(network, everyone(3), 40)
    assert network.length(2, 0) == 11


def test_no_entries_are_sent_whose_predecessors_all_in_range_lack() -> None:
    network, reach = gossip(3), {0: [2], 1: [], 2: [0]}
    for _ in range(4):
        network.append(0, 2)
        step(network, APART)
    for _ in range(GREETING + 1):
        step(network, reach, 20)
    network.append(0, 1)
    for _ in range(12):
        before = network.length(2, 0)
        step(network, reach, 20)
        sent = [
            p
            for frame in broadcasts(network).values()
            for p in packet_codec.decode(frame)
            if isinstance(p, Fragment)
        ]
        assert not sent or network.length(2, 0) > before
    assert network.length(2, 0) == 9


@pytest.mark.parametrize(
    ("acks", "incarnations", "valid"), [(False, 1, False), (False, 2, True), (True, 1, True)]
)
def test_a_robot_reports_its_own_map_only_after_a_restart_or_to_ask_for_reports(
    acks: bool, incarnations: int, valid: bool
) -> None:
    each = make_engine(0, 2, lambda *_: [], "gossip", requires_acks=acks, incarnations=incarnations)
    each.open_round(0, [1], None)
    rejected = each.close_round(closing((1, encode([HeldFirst(1, 0)]))))
    assert bool(rejected) != valid


# Byzantine peers.


any_packet = st.one_of(
    st.builds(From, st.integers(0, 255), st.integers(0, 2**24 - 1) | st.integers(0, 4)),
    st.builds(FromFirst, st.integers(0, 4), st.integers(0, 9)),
    st.builds(Held, st.integers(0, 255), st.integers(0, 2**24 - 1) | st.integers(0, 4)),
    st.builds(HeldFirst, st.integers(0, 4), st.integers(0, 9)),
    st.builds(Near, st.integers(0, 255)),
    st.builds(Gone, st.integers(0, 4)),
    st.builds(Offer, st.integers(0, 63), st.integers(0, 63)),
    st.builds(Target, st.integers(0, 2047), st.integers(0, 2047)),
    st.builds(Fragment, st.binary(min_size=1, max_size=9)),
    st.just(Save()),
)
frames = st.lists(any_packet, max_size=6).map(encode) | st.binary(max_size=12)


@given(st.lists(frames, max_size=8), seeds, st.booleans())
def test_honest_robots_go_on_with_each_other_whatever_another_sends(
    lies: list[bytes], seed: int, acks: bool
) -> None:
    network = Network(3, "gossip", seed, acks=acks)
    reach = {0: [1, 2], 1: [0, 2]}
    for lie in lies:
        for robot in (0, 1):
            network.append(robot, 1)
            each = network.engines[robot]
            each.open_round(0, list(reach[robot]), None)
            assert {rejected.peer for rejected in each.close_round(closing((2, lie)))} <= {2}
        network.step(reach, None, 1)
    for _ in range(60 if acks else 2):
        network.step(reach, None, 1)
    for of in (0, 1):
        assert [network.held(robot, of) for robot in (0, 1)] == 2 * [network.written(of)]


@pytest.mark.parametrize("acks", [False, True])
def test_claims_of_more_entries_than_there_are_silence_no_robot(acks: bool) -> None:
    network = Network(3, "gossip", acks=acks)
    lie = (
        encode([HeldFirst(0, 255), FromFirst(0, 0)]) + b"".join(entries(0, 0, 200)) + encode([Held(0, 9999)])
    )
    for number in range(1, 9):
        network.append(0, 1)
        maker = network.engines[0]
        assert {rejected.peer for rejected in maker.close_round(closing((2, lie)))} == {2}
        assert maker.undelivered() >= 0
        network.step({0: [1, 2], 1: [0, 2]}, None, 1)
        assert network.length(1, 0) == number


def test_claims_in_acknowledged_frames_harm_no_other_robot() -> None:
    network = Network(3, acks=True, seed=3)
    network.append(0, 20)
    lie = encode(
        [Held(0, 10_000), HeldFirst(2, 200), Offer(0, 3), From(1, 7), *packet_codec.decode(entry(1, 7))]
    )
    for robot in (0, 2):
        assert not network.engines[robot].close_round(closing((1, lie)))
    for _ in range(40):
        network.step({0: [2], 2: [0]})
    assert network.held(2, of=0) == network.written(0)
    assert network.engines[0].undelivered() == 20, "robot 1 was sent nothing"
