"""The `scans` encoding: receivers draw the scans of the author; malformed data changes nothing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.encodings.catalog import ENCODINGS, make_encoding
from agent.encodings.none import NoEncoding
from agent.encodings.scans import ScanEncoding
from agent.encodings.votes import MANY
from agent.settings import EncodingSettings, ReplicationSettings, Settings
from protocol.body import Body
from protocol.errors import ProtocolError
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid, ray_table
from protocol.packet_codec import encode
from protocol.packets import Delete, Fragment, Save
from protocol.scans import HIT, NONE, GridChange, Scan, draw, encode_scan, fragments, scan_size
from tests.agent.encodings.arrival import LATE

BEAMS = 36
RANGES = [6.0, 3.5, 9.0]
WIDTH, HEIGHT = 20, 14
NOTHING = GridChange(0, (WIDTH, HEIGHT, 0, 0))
seeds = st.integers(0, 2**32 - 1)


def settings_of(robot: int, map_encoding: str = "scans") -> Settings:
    return Settings(
        robot=robot, bodies=tuple(Body(cells, 360.0, 1.0) for cells in RANGES), width=WIDTH, height=HEIGHT,
        beams=BEAMS, seed=0, strategy="meier", encoding=EncodingSettings(map_encoding),
        replication=ReplicationSettings("backoff"),
    )  # fmt: skip


def random_scan(rng: np.random.Generator, robot: int) -> Scan:
    lengths = np.diff(ray_table(RANGES[robot], BEAMS).start)
    crossed = rng.integers(0, lengths + 1)
    readings = (crossed | np.where((rng.random(BEAMS) < 0.5) & (crossed < lengths), HIT, 0)).astype(np.uint16)
    readings[rng.random(BEAMS) < 0.2] = NONE
    return Scan(int(rng.integers(WIDTH)), int(rng.integers(HEIGHT)), readings)


def record(maker: ScanEncoding, scan: Scan) -> list[bytes]:
    return maker.encode_changes(empty(), scan, NOTHING, delivered=True)


def empty() -> Grid:
    return np.zeros((HEIGHT, WIDTH), np.uint8)


def scans(seed: int, robot: int, count: int = 4) -> list[Scan]:
    rng = np.random.default_rng(seed)
    return [random_scan(rng, robot) for _ in range(count)]


def drawn(seen: list[tuple[int, Scan]]) -> Grid:
    grid = empty()
    for robot, scan in seen:
        draw(grid, ray_table(RANGES[robot], BEAMS), scan.x, scan.y, scan.readings)
    return grid


@given(seeds, st.integers(0, 2))
def test_receivers_draw_the_logged_scans(seed: int, robot: int) -> None:
    maker, receiver = ScanEncoding(settings_of(robot)), ScanEncoding(settings_of((robot + 1) % 3))
    seen = scans(seed, robot)
    for scan in seen:
        receiver.apply(robot, b"".join(record(maker, scan)), **LATE)
    assert receiver.merge(empty()).tolist() == drawn([(robot, scan) for scan in seen]).tolist()


@given(seeds, st.lists(st.integers(0, 8), max_size=30))
def test_fragments_of_any_size_give_the_same_grid(seed: int, pieces: list[int]) -> None:
    maker, receiver = ScanEncoding(settings_of(0)), ScanEncoding(settings_of(1))
    seen = scans(seed, 0)
    packets = [packet for scan in seen for packet in record(maker, scan)]
    whole = len(fragments(bytes(scan_size(BEAMS))))
    taken = 0
    for piece in [*pieces, len(packets)]:
        receiver.apply(0, b"".join(packets[taken : taken + piece]), **LATE)
        taken = min(taken + piece, len(packets))
        complete = [(0, scan) for scan in seen[: taken // whole]]
        assert receiver.merge(empty()).tolist() == drawn(complete).tolist()


@given(seeds)
def test_logs_of_several_robots_do_not_mix(seed: int) -> None:
    makers = [ScanEncoding(settings_of(robot)) for robot in (0, 2)]
    receiver = ScanEncoding(settings_of(1))
    seen = {robot: scans(seed + robot, robot) for robot in (0, 2)}
    logs = {
        robot: [packet for scan in seen[robot] for packet in record(maker, scan)]
        for robot, maker in zip((0, 2), makers, strict=True)
    }
    for number in range(max(map(len, logs.values()))):
        for robot, packets in logs.items():
            receiver.apply(robot, b"".join(packets[number : number + 1]), **LATE)
    reported = receiver.merge(empty())
    assert ((reported != UNKNOWN) == (drawn([(r, s) for r in seen for s in seen[r]]) != UNKNOWN)).all()


def test_a_repeated_scan_is_not_logged() -> None:
    maker = ScanEncoding(settings_of(0))
    one, other = scans(1, 0, 2)
    assert record(maker, one)
    assert record(maker, one) == []
    assert record(maker, other)
    assert record(maker, one)


def test_a_scanner_that_is_off_has_nothing_to_log() -> None:
    maker = ScanEncoding(settings_of(0))
    assert record(maker, Scan(1, 1, np.full(BEAMS, NONE, np.uint16))) == []


def test_each_log_entry_is_one_packet() -> None:
    packets = record(ScanEncoding(settings_of(0)), scans(1, 0, 1)[0])
    assert sum(len(packet) for packet in packets) == scan_size(BEAMS) + 3
    assert all(len(packet) <= 64 for packet in packets)


@given(seeds)
def test_the_self_explored_grid_takes_precedence_over_received_cells(seed: int) -> None:
    maker, receiver = ScanEncoding(settings_of(0)), ScanEncoding(settings_of(1))
    for scan in scans(seed, 0):
        receiver.apply(0, b"".join(record(maker, scan)), **LATE)
    rng = np.random.default_rng(seed)
    own = rng.choice(np.array([UNKNOWN, FREE, OCCUPIED], np.uint8), (HEIGHT, WIDTH))
    own[MANY // WIDTH :] = UNKNOWN  # it contradicts the map in too few cells to doubt it
    received, before = receiver.merge(empty()), own.copy()
    merged = receiver.merge(own)
    assert (merged[own != UNKNOWN] == own[own != UNKNOWN]).all()
    assert (merged[own == UNKNOWN] == received[own == UNKNOWN]).all()
    assert (own == before).all()
    merged[:] = OCCUPIED
    assert receiver.merge(empty()).tolist() == received.tolist()


def whole(x: int, y: int, reading: int) -> list[bytes]:
    return fragments(encode_scan(Scan(x, y, np.full(BEAMS, reading, np.uint16))))


MALFORMED = {
    "another packet": [encode([Save()])],
    "another packet behind a fragment": [*whole(1, 1, 0)[:1], encode([Delete(3)])],
    "bytes that are no packet": [b"\xff"],
    "a fragment cut off": [whole(1, 1, 0)[0][:-1]],
    "a reading beyond its beam": whole(1, 1, 10),
    "a cell beyond the grid": whole(WIDTH, 1, 0),
    "a cell below the grid": whole(1, HEIGHT, 0),
    "a cell beyond any grid": whole(60000, 1, 0),
    "more than a scan": [*whole(1, 1, 0)[:-1], encode([Fragment(bytes(63))])],
}


@pytest.mark.parametrize("packets", MALFORMED.values(), ids=list(MALFORMED))
def test_malformed_data_is_rejected_and_changes_nothing(packets: list[bytes]) -> None:
    maker, receiver = ScanEncoding(settings_of(0)), ScanEncoding(settings_of(1))
    first, second = scans(3, 0, 2)
    log = record(maker, first) + record(maker, second)
    receiver.apply(0, b"".join(log[:3]), **LATE)
    before = receiver.merge(empty()).tolist()
    for _ in range(2):
        with pytest.raises(ProtocolError):
            receiver.apply(0, b"".join([*log[3:], *packets]), **LATE)
        assert receiver.merge(empty()).tolist() == before
    receiver.apply(0, b"".join(log[3:]), **LATE)
    assert receiver.merge(empty()).tolist() == drawn([(0, first), (0, second)]).tolist()


@given(st.lists(st.binary(min_size=1, max_size=63), max_size=12))
def test_fragments_of_noise_are_rejected_or_change_only_cells_within_sensor_range(noise: list[bytes]) -> None:
    receiver = ScanEncoding(settings_of(1))
    try:
        receiver.apply(0, b"".join([encode([Fragment(data)]) for data in noise]), **LATE)
    except ProtocolError:
        assert not receiver.merge(empty()).any()


def test_without_map_exchange_a_robot_sends_nothing_and_plans_on_its_self_explored_grid() -> None:
    alone = NoEncoding(settings_of(0))
    own = drawn([(0, scans(1, 0, 1)[0])])
    assert alone.encode_changes(own, scans(1, 0, 1)[0], NOTHING, delivered=True) == []
    merged = alone.merge(own)
    assert merged.tolist() == own.tolist()
    assert merged is not own
    with pytest.raises(ProtocolError, match="this team exchanges no maps"):
        alone.apply(1, encode([Save()]), **LATE)


def test_map_encodings_are_found_by_name() -> None:
    assert {"scans", "none"} <= set(ENCODINGS)
    assert isinstance(make_encoding(settings_of(0)), ScanEncoding)
    with pytest.raises(ValueError, match=r"no map encoding is called 'smoke'; there are: .*scans"):
        make_encoding(settings_of(0, "smoke"))
