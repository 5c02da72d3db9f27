"""The `predictive` encoding: receivers decode what the author observed, in any order of logs and fragments."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from agent.encoding_options import PredictiveOptions
from agent.encodings.predictive import PredictiveEncoding
from agent.encodings.update_packets import ENOUGH_STEPS, fragments
from agent.predictive.scan_author import CELLS_PER_BYTE
from agent.settings import EncodingSettings, MediumSettings, ReplicationSettings, Settings
from protocol.body import Body
from protocol.budget import UNLIMITED, Budget
from protocol.errors import ProtocolError
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid, ray_table
from protocol.packet_codec import decode_kind, encode
from protocol.packets import UPDATE_DATA, UPDATE_NUMBERS, UPDATE_PART, Delete, Fragment, Update
from protocol.scans import GridChange, Scan, draw
from tests.agent.encodings.arrival import LATE
from worldsim.laser import cast

BEAMS = 36
RANGES = [6.0, 3.5, 9.0]
WIDTH, HEIGHT = 20, 14
seeds = st.integers(0, 2**32 - 1)


def settings_of(robot: int, base: Any = "team", bandwidth: Budget = UNLIMITED) -> Settings:
    return Settings(
        robot=robot, bodies=tuple(Body(cells, 360.0, 1.0) for cells in RANGES), width=WIDTH, height=HEIGHT,
        beams=BEAMS, seed=0, strategy="meier",
        encoding=EncodingSettings("predictive", predictive=PredictiveOptions(base)),
        replication=ReplicationSettings("gossip"), medium=MediumSettings(bandwidth),
    )  # fmt: skip


class Explorer:
    """A robot that scans from random cells, and its map encoding."""

    def __init__(self, robot: int, seed: int, common: dict[str, Any] | None = None, **more: Any) -> None:
        self.robot = robot
        self.map_encoding = PredictiveEncoding(settings_of(robot, **more))
        if common is not None:
            self.map_encoding.use_shared_cache(common)
        self.own: Grid = np.zeros((HEIGHT, WIDTH), np.uint8)
        self.rng = np.random.default_rng([seed, robot])
        self.log: list[bytes] = []

    def scan(self, truth: Grid, *, delivered: bool = True, noise: int = 0) -> list[bytes]:
        """Take a scan, flip some known cells, and encode the changes."""
        no_robots, beams = np.zeros(truth.shape, np.bool_), ray_table(RANGES[self.robot], BEAMS)
        x, y = int(self.rng.integers(WIDTH)), int(self.rng.integers(HEIGHT))
        readings = cast(truth, no_robots, beams, x, y)
        change = draw(self.own, beams, x, y, readings)
        for _ in range(noise):
            at_x, at_y = int(self.rng.integers(WIDTH)), int(self.rng.integers(HEIGHT))
            self.own[at_y, at_x] = self.rng.choice((FREE, OCCUPIED))
            cells, (x0, y0, x1, y1) = change
            far = max(x1, at_x + 1), max(y1, at_y + 1)
            change = GridChange(cells + 1, (min(x0, at_x), min(y0, at_y), *far))
        packets = self.map_encoding.encode_changes(
            self.own, Scan(x, y, readings), change, delivered=delivered
        )
        self.log += packets
        return packets


def world(seed: int) -> Grid:
    rng = np.random.default_rng(seed)
    return np.where(rng.random((HEIGHT, WIDTH)) < 0.85, FREE, OCCUPIED).astype(np.uint8)


def flush(explorer: Explorer) -> list[bytes]:
    """Let a robot stand still until it has reported all."""
    sent: list[bytes] = []
    nothing = GridChange(0, (WIDTH, HEIGHT, 0, 0))
    for _ in range(ENOUGH_STEPS):
        scan = Scan(0, 0, np.full(BEAMS, 0, np.uint16))
        sent += explorer.map_encoding.encode_changes(explorer.own, scan, nothing, delivered=True)
    explorer.log += sent
    return sent


def unknown() -> Grid:
    return np.zeros((HEIGHT, WIDTH), np.uint8)


def test_if_one_packet_fills_the_budget_updates_rank_by_their_new_cells_per_byte() -> None:
    for truth in (np.full((HEIGHT, WIDTH), FREE, np.uint8), world(3)):
        explorer = Explorer(0, 1, bandwidth=Budget(20))
        message = b"".join(update.data for update in decode_kind(b"".join(explorer.scan(truth)), Update))
        per_byte = np.count_nonzero(explorer.own != UNKNOWN) / len(message)
        assert explorer.map_encoding.urgency == pytest.approx(per_byte / CELLS_PER_BYTE)
    explorer = Explorer(0, 1, bandwidth=Budget(21))
    assert explorer.scan(world(3)) and explorer.map_encoding.urgency is None


@given(seeds, st.sampled_from(("team", "own")), st.sampled_from((0, 0, 3)))
def test_every_team_member_ends_with_the_cells_that_any_of_them_observed(
    seed: int, base: str, noise: int
) -> None:
    truth = world(seed)
    team = [Explorer(robot, seed, base=base) for robot in range(3)]
    for _ in range(6):
        sent = [(each.robot, each.scan(truth, noise=noise)) for each in team]
        for each in team:
            for robot, packets in sent:
                if robot != each.robot:
                    each.map_encoding.apply(robot, b"".join(packets), **LATE)
    last = [(each.robot, flush(each)) for each in team]
    for each in team:
        for robot, packets in last:
            if robot != each.robot:
                each.map_encoding.apply(robot, b"".join(packets), **LATE)
    reported = [each.map_encoding.merge(unknown()) for each in team]
    assert all((grid == reported[0]).all() for grid in reported)
    seen = [each.own for each in team]
    assert ((reported[0] != UNKNOWN) == np.any([own != UNKNOWN for own in seen], axis=0)).all()
    assert np.any([(reported[0] == own) for own in seen], axis=0).all()
    if not noise or base == "own":
        outvoted = np.sum([own == FREE for own in seen], axis=0) == 2
        expected = np.where(outvoted & (np.max(seen, axis=0) == OCCUPIED), FREE, np.max(seen, axis=0))
        assert (reported[0] == expected).all()
    for each in team:
        planning = each.map_encoding.merge(each.own)
        assert (planning[each.own != UNKNOWN] == each.own[each.own != UNKNOWN]).all()


@given(seeds, st.integers(0, 2**32 - 1))
def test_fragments_and_the_order_of_maps_do_not_change_the_result(seed: int, order: int) -> None:
    truth = world(seed)
    authors = [Explorer(robot, seed) for robot in (0, 1)]
    for _ in range(6):
        for author, other in (authors, authors[::-1]):
            other.map_encoding.apply(author.robot, b"".join(author.scan(truth)), **LATE)
    for author, other in (authors, authors[::-1]):
        other.map_encoding.apply(author.robot, b"".join(flush(author)), **LATE)
    receiver, rng = PredictiveEncoding(settings_of(2)), np.random.default_rng(order)
    logs = [list(author.log) for author in authors]
    while any(logs):
        robot = int(rng.integers(2))
        count = int(rng.integers(1, 4))
        receiver.apply(robot, b"".join(logs[robot][:count]), **LATE)
        del logs[robot][:count]
    assert (receiver.merge(unknown()) == np.max([author.own for author in authors], axis=0)).all()


def test_the_first_scan_is_encoded_before_robots_in_range_are_known_but_not_the_second() -> None:
    truth = world(0)
    author, receiver = Explorer(0, 0), PredictiveEncoding(settings_of(1))
    receiver.apply(0, b"".join(author.scan(truth, delivered=False)), **LATE)
    assert (receiver.merge(unknown()) == author.own).all()
    assert np.count_nonzero(author.own)
    assert author.scan(truth, delivered=False) == []


@given(seeds)
def test_changes_that_wait_are_sent_in_one_update_later(seed: int) -> None:
    truth = world(seed)
    author, receiver = Explorer(0, seed), PredictiveEncoding(settings_of(1))
    receiver.apply(0, b"".join(author.scan(truth)), **LATE)
    for _ in range(5):
        assert author.scan(truth, delivered=False) == []
    packets = author.scan(truth)
    assert sum(update.number is not None for update in decode_kind(b"".join(packets), Update)) == 1
    receiver.apply(0, b"".join(packets), **LATE)
    assert (receiver.merge(unknown()) == author.own).all()


@given(seeds)
def test_a_small_budget_splits_changes_into_one_update_per_step(seed: int) -> None:
    truth = world(seed)
    author, receiver = (
        Explorer(0, seed, bandwidth=Budget(6)),
        PredictiveEncoding(settings_of(1, bandwidth=Budget(6))),
    )
    receiver.apply(0, b"".join(author.scan(truth)), **LATE)
    for _ in range(5):
        assert author.scan(truth, delivered=False) == []
    packets = 0
    while sent := flush(author):
        receiver.apply(0, b"".join(sent), **LATE)
        packets += sum(update.number is not None for update in decode_kind(b"".join(sent), Update))
    assert (receiver.merge(unknown()) == author.own).all()
    assert packets > 1 or np.count_nonzero(author.own) < 200


@given(seeds, st.booleans())
def test_author_and_receivers_know_the_same_dependencies(seed: int, taken_back: bool) -> None:
    truth = world(seed)
    first, second, receiver = Explorer(0, seed), Explorer(1, seed), PredictiveEncoding(settings_of(2))
    for _ in range(6):
        second.map_encoding.apply(0, b"".join(first.scan(truth)), **LATE)
        packets = second.scan(truth)
        if taken_back and second.map_encoding.retractable:
            second.map_encoding.retract_last()
            del second.log[len(second.log) - len(packets) :]
        else:
            first.map_encoding.apply(1, b"".join(packets), **LATE)
    bases = second.map_encoding.dependencies(1)
    assert list(first.map_encoding.dependencies(1)) == list(bases)
    read = [0, 0]
    for first_unit, end, on in bases:  # these dependencies, and no more, suffice to decode each update
        assert read[1] <= first_unit < end <= len(second.log)
        for map_id, log, packets in (*((0, first.log, packets) for _, packets in on), (1, second.log, end)):
            receiver.apply(map_id, b"".join(log[read[map_id] : packets]), **LATE)
            read[map_id] = max(read[map_id], packets)
        assert receiver.dependencies(1)[-1].end == end


@pytest.mark.parametrize(("budget", "is_settled"), [(6, True), (50, False)])
def test_a_full_update_is_encoded_again_only_after_news_of_teammates(budget: int, is_settled: bool) -> None:
    truth = world(0)
    author, other = (Explorer(robot, 0, bandwidth=Budget(budget)) for robot in range(2))
    author.scan(truth)
    for _ in range(8):
        assert author.scan(truth, delivered=False) == []
    sent = author.scan(truth)
    assert author.map_encoding.is_settled == is_settled
    assert author.scan(truth, delivered=False) == []
    assert author.map_encoding.retractable == (len(sent) if is_settled else 0)
    author.map_encoding.apply(1, b"".join(other.scan(truth)), **LATE)
    assert not author.map_encoding.is_settled


@given(seeds)
def test_a_retracted_update_is_contained_in_the_next_one(seed: int) -> None:
    truth = world(seed)
    author, receiver = Explorer(0, seed), PredictiveEncoding(settings_of(1))
    packets = author.scan(truth)
    assume(packets)
    assert author.map_encoding.retractable == len(packets)
    author.map_encoding.retract_last()
    assert not author.map_encoding.merge(unknown()).any()
    receiver.apply(0, b"".join(author.scan(truth)), **LATE)
    assert (receiver.merge(unknown()) == author.own).all()


def test_a_scan_without_news_is_not_sent() -> None:
    truth = np.full((HEIGHT, WIDTH), FREE, np.uint8)
    first, second = Explorer(2, 1), Explorer(0, 1)
    for _ in range(40):
        second.map_encoding.apply(2, b"".join(first.scan(truth)), **LATE)
    second.map_encoding.apply(2, b"".join(flush(first)), **LATE)
    assert (second.map_encoding.merge(unknown()) == FREE).all()
    assert [second.scan(truth) for _ in range(5)] == 5 * [[]]
    assert second.own.any()


@pytest.mark.parametrize(
    ("bandwidth", "steps"),
    [(UNLIMITED, 0), (Budget(1000), 0), (Budget(50), 1), (Budget(25), 3), (Budget(1), 3)],
)
def test_few_new_cells_wait_if_bandwidth_is_scarce(bandwidth: Budget, steps: int) -> None:
    truth = np.full((HEIGHT, WIDTH), OCCUPIED, np.uint8)
    truth[5, 5] = FREE
    explorer = Explorer(0, 0, bandwidth=bandwidth)
    no_robots, beams = np.zeros(truth.shape, np.bool_), ray_table(RANGES[0], BEAMS)
    scan = Scan(5, 5, cast(truth, no_robots, beams, 5, 5))
    own = unknown()
    own[5, 5] = FREE
    sent = [
        explorer.map_encoding.encode_changes(own, scan, GridChange(1, (5, 5, 6, 6)), delivered=True)
        for _ in range(ENOUGH_STEPS)
    ]
    assert [bool(packets) for packets in sent].index(True) == steps


@given(seeds, st.sampled_from(("team", "own")), st.booleans())
def test_shared_decoding_gives_each_robot_the_result_of_decoding_alone(
    seed: int, base: str, forged: bool
) -> None:
    """At their own pace, with retracted updates; a byzantine robot sends different updates to each of them."""
    truth, rng = world(seed), np.random.default_rng(seed)
    teams = [[Explorer(robot, seed, common, base=base) for robot in range(3)] for common in (None, {})]
    reported = [[0] * 3 for _ in range(3)]
    for _ in range(12):
        sender = int(rng.integers(3))
        lost, noise, wrong = rng.random() < 0.3, int(rng.integers(4)), rng.random() < 0.5
        for team in teams:
            author = team[sender]
            if (
                lost
                and author.map_encoding.retractable
                and all(reported[to][sender] < len(author.log) for to in range(3))
            ):
                del author.log[len(author.log) - author.map_encoding.retractable :]
                author.map_encoding.retract_last()
            author.scan(truth, noise=noise)
        assert teams[0][sender].log == teams[1][sender].log
        receiver, map_id = int(rng.integers(3)), int(rng.integers(3))
        received = teams[0][map_id].log[reported[receiver][map_id] :][: int(rng.integers(4))]
        if receiver == map_id or not received:
            continue
        reported[receiver][map_id] += len(received)
        if forged and map_id == 2 and wrong:
            (update,) = decode_kind(received[0], Update)
            received[0] = encode([Update(update.number, bytes(byte ^ receiver + 1 for byte in update.data))])
        sent = []
        for team in teams:
            try:
                team[receiver].map_encoding.apply(map_id, b"".join(received), **LATE)
            except ProtocolError as error:
                sent.append(str(error))
            else:
                sent.append("")
        assert sent[0] == sent[1]
        for alone, together in zip(*teams, strict=True):
            assert (alone.map_encoding.merge(unknown()) == together.map_encoding.merge(unknown())).all()
            assert [alone.map_encoding.scan_cell(robot) for robot in range(3)] == [
                together.map_encoding.scan_cell(robot) for robot in range(3)
            ]


def units_of(seed: int) -> list[bytes]:
    author = Explorer(0, seed)
    packets: list[bytes] = []
    for _ in range(3):
        packets += author.scan(world(seed))
    return packets


WRONG = {
    "another kind": [encode([Delete(3)])],
    "a raw scan": [encode([Fragment(b"scan")])],
    "another update than the next": [encode([Update(1, b"\x12\x34")])],
    "bytes that are no update": [encode([Update(0, bytes(range(40)))])],
}


@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("behind", [False, True])
def test_malformed_data_is_rejected_and_changes_nothing(wrong: str, behind: bool) -> None:
    receiver = PredictiveEncoding(settings_of(1))
    packets = units_of(5)
    head = packets[:1] if behind and decode_kind(packets[0], Update)[0].number is None else []
    receiver.apply(0, b"".join(head), **LATE)
    before = receiver.merge(unknown())
    with pytest.raises(ProtocolError):
        receiver.apply(
            0,
            b"".join(
                [*head, *WRONG[wrong]] if wrong == "bytes that are no update" and head else WRONG[wrong]
            ),
            **LATE,
        )
    assert (receiver.merge(unknown()) == before).all()
    receiver.apply(0, b"".join(packets[len(head) :]), **LATE)
    assert receiver.merge(unknown()).any()


@given(st.lists(st.tuples(st.integers(0, 1), st.binary(max_size=UPDATE_DATA)), max_size=12), seeds)
def test_a_byzantine_robot_changes_no_map_but_its_own(forged: list[tuple[int, bytes]], seed: int) -> None:
    truth = world(seed)
    author, receiver = Explorer(0, seed), PredictiveEncoding(settings_of(1))
    plain = PredictiveEncoding(settings_of(1))
    for number, (_, data) in enumerate(forged):
        packets = author.scan(truth)
        with contextlib.suppress(ProtocolError):
            receiver.apply(2, encode([Update(number % UPDATE_NUMBERS, data)]), **LATE)
        receiver.apply(0, b"".join(packets), **LATE)
        plain.apply(0, b"".join(packets), **LATE)
    known = plain.merge(unknown())
    assert (receiver.merge(unknown())[known == OCCUPIED] == OCCUPIED).all()
    assert (receiver.merge(unknown())[known == FREE] != UNKNOWN).all()


sizes = st.integers(UPDATE_PART, UPDATE_DATA)


@given(st.binary(max_size=300), st.integers(0, 100), sizes, sizes)
def test_fragments_reassemble_to_the_update(message: bytes, number: int, most: int, size: int) -> None:
    size = min(size, most)
    *cut, last = decode_kind(b"".join(fragments(message, number, most, size)), Update)
    assert b"".join(piece.data for piece in (*cut, last)) == message
    assert all(len(piece.data) == size and piece.number is None for piece in cut)
    assert last.number == number % UPDATE_NUMBERS
    assert len(last.data) <= most


@given(seeds, st.booleans())
def test_retracting_an_update_on_which_another_log_claims_to_depend_is_safe(seed: int, shared: bool) -> None:
    """A forger guesses an update that was never sent, and sends an update that depends on it."""
    truth = world(seed)
    cache: dict[str, Any] | None = {} if shared else None
    victim, forger, third = Explorer(0, seed, cache), Explorer(1, seed), PredictiveEncoding(settings_of(2))
    unsent = victim.scan(truth)
    assume(unsent)
    forger.map_encoding.apply(0, b"".join(unsent), **LATE)
    forged = forger.scan(truth)
    assume(forger.map_encoding.dependencies(1))
    victim.map_encoding.apply(1, b"".join(forged), **LATE)
    for _ in range(4):
        victim.map_encoding.merge(victim.own)
        if retractable := victim.map_encoding.retractable:
            victim.map_encoding.retract_last()
            del victim.log[len(victim.log) - retractable :]
        victim.scan(truth)
    flush(victim)
    third.apply(1, b"".join(forged), **LATE)
    third.apply(0, b"".join(victim.log), **LATE)
    assert (third.merge(unknown()) == victim.map_encoding.merge(unknown())).all()
