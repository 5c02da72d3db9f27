"""Scans: readings, their binary form, and the cells that drawing changes."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from protocol.errors import ProtocolError
from protocol.grid import FREE, MAX_SIDE, OCCUPIED, UNKNOWN, Grid, RayTable, ray_table
from protocol.packet_codec import decode, encode
from protocol.packets import AnyPacket, Fragment
from protocol.scans import (
    HIT,
    NONE,
    GridChange,
    Readings,
    Scan,
    check_readings,
    contents,
    decode_scan,
    draw,
    encode_scan,
    fragments,
    scan_size,
)
from tests.protocol.test_packets import streams

FAN = ray_table(6.0, 40)
seeds = st.integers(0, 2**32 - 1)


def readings_of(seed: int, laid: RayTable = FAN) -> Readings:
    """Random readings, all of which the beams can give."""
    rng = np.random.default_rng(seed)
    lengths = np.diff(laid.start)
    crossed = rng.integers(0, lengths + 1)
    hit = rng.random(laid.beams) < 0.5
    readings = (crossed | np.where(hit & (crossed < lengths), HIT, 0)).astype(np.uint16)
    readings[rng.random(laid.beams) < 0.2] = NONE
    return readings


def random_grid(seed: int, states: tuple[int, ...] = (UNKNOWN, FREE, OCCUPIED)) -> Grid:
    rng = np.random.default_rng(seed)
    height, width = rng.integers(1, 16, 2)
    return rng.choice(np.array(states, np.uint8), (height, width))


def plainly_drawn(grid: Grid, laid: RayTable, x: int, y: int, readings: Readings) -> tuple[Grid, GridChange]:
    """Claim by claim: the robot's own cell, then each beam from near to far."""
    claims = [(x, y, FREE)]
    for (begin, end), reading in zip(pairwise(laid.start.tolist()), readings.tolist(), strict=True):
        if reading != NONE:
            walk = laid.cells[begin:end].tolist()
            crossed = reading & 0x7FFF
            claims += [(x + dx, y + dy, FREE) for dx, dy in walk[:crossed]]
            if reading & HIT:
                claims.append((x + walk[crossed][0], y + walk[crossed][1], OCCUPIED))
    height, width = grid.shape
    result = grid.copy()
    changed = []
    for cx, cy, state in claims:
        if 0 <= cx < width and 0 <= cy < height and result[cy, cx] == UNKNOWN:
            result[cy, cx] = state
            changed.append((cx, cy))
    if not changed:
        return result, GridChange(0, (width, height, 0, 0))
    xs, ys = zip(*changed, strict=True)
    return result, GridChange(len(changed), (min(xs), min(ys), max(xs) + 1, max(ys) + 1))


def test_a_scan_of_360_beams_has_724_bytes() -> None:
    assert scan_size(360) == 724
    laid = ray_table(50.0)
    data = encode_scan(Scan(3, 4, readings_of(0, laid)))
    assert len(data) == 724
    assert decode_scan(data, laid).x == 3


def test_a_scan_is_big_endian_cell_first() -> None:
    laid = ray_table(1.0, 4)
    scan = Scan(258, 3, np.array([1, HIT, NONE, 0], np.uint16))
    assert encode_scan(scan).hex(" ", 2) == "0102 0003 0001 8000 7fff 0000"
    assert decode_scan(encode_scan(scan), laid).readings.tolist() == [1, HIT, NONE, 0]


@given(seeds, st.integers(0, MAX_SIDE - 1), st.integers(0, MAX_SIDE - 1))
def test_decoding_inverts_encoding(seed: int, x: int, y: int) -> None:
    scan = Scan(x, y, readings_of(seed))
    read = decode_scan(encode_scan(scan), FAN)
    assert (read.x, read.y) == (x, y)
    assert read.readings.dtype == np.uint16
    assert read.readings.tolist() == scan.readings.tolist()


@pytest.mark.parametrize("size", [0, 1, scan_size(40) - 1, scan_size(40) + 1, scan_size(40) + 2])
def test_a_scan_of_the_wrong_length_is_rejected(size: int) -> None:
    with pytest.raises(ProtocolError, match=rf"scan at byte 0: {size} bytes instead of 84"):
        decode_scan(bytes(size), FAN)


@pytest.mark.parametrize(("x", "y"), [(MAX_SIDE, 0), (0, MAX_SIDE), (65535, 65535)])
def test_a_scan_from_outside_any_grid_is_rejected(x: int, y: int) -> None:
    with pytest.raises(ProtocolError, match=r"scan at byte 0: cell .* is outside"):
        decode_scan(encode_scan(Scan(x, y, readings_of(1))), FAN)


@pytest.mark.parametrize("beam", [0, 7, 39])
@pytest.mark.parametrize("beyond", [0, 1, 0x7FFE - 40])
@pytest.mark.parametrize("hit", [0, HIT])
def test_a_reading_longer_than_its_beam_is_rejected(beam: int, beyond: int, hit: int) -> None:
    readings = np.zeros(40, np.uint16)
    most = int(np.diff(FAN.start)[beam])
    readings[beam] = (most + 1 + beyond - (hit > 0)) | hit
    with pytest.raises(ProtocolError, match=rf"scan at byte {4 + 2 * beam}: beam {beam} .* {most}"):
        decode_scan(encode_scan(Scan(0, 0, readings)), FAN)


def test_a_hit_beyond_any_beam_is_rejected() -> None:
    with pytest.raises(ProtocolError, match="beam 3"):
        check_readings(np.array(3 * [NONE] + [NONE | HIT] + 36 * [0], np.uint16), FAN)


def test_readings_for_another_laser_are_rejected() -> None:
    with pytest.raises(ProtocolError, match="39 readings for 40 beams"):
        check_readings(np.zeros(39, np.uint16), FAN)


@given(st.binary(min_size=84, max_size=84), seeds)
@example(b"\x00\x03\x00\x03" + 80 * b"\xff", 0)
@example(b"\x00\x03\x00\x03" + 80 * b"\x7f", 0)
def test_random_bytes_are_rejected_or_a_scan_within_range(noise: bytes, seed: int) -> None:
    try:
        scan = decode_scan(noise, FAN)
    except ProtocolError:
        return
    grid = random_grid(seed, (UNKNOWN,))
    before = grid.copy()
    draw(grid, FAN, scan.x, scan.y, scan.readings)
    ys, xs = np.nonzero(grid != before)
    assert all((xs - scan.x) ** 2 + (ys - scan.y) ** 2 <= 36)


@given(seeds, seeds, st.integers(0, 15), st.integers(0, 15))
def test_drawing_equals_the_plain_reference(map_seed: int, scan_seed: int, x: int, y: int) -> None:
    grid, readings = random_grid(map_seed, (UNKNOWN, UNKNOWN, FREE, OCCUPIED)), readings_of(scan_seed)
    x, y = x % grid.shape[1], y % grid.shape[0]
    expected, expected_change = plainly_drawn(grid, FAN, x, y, readings)
    change = draw(grid, FAN, x, y, readings)
    assert grid.tolist() == expected.tolist()
    assert change == expected_change


@given(seeds, seeds)
def test_drawing_changes_no_known_cell(map_seed: int, scan_seed: int) -> None:
    grid, readings = random_grid(map_seed), readings_of(scan_seed)
    before = grid.copy()
    change = draw(grid, FAN, 2, 2, readings)
    assert (grid[before != UNKNOWN] == before[before != UNKNOWN]).all()
    assert change.cells == np.count_nonzero(grid != before)
    assert draw(grid, FAN, 2, 2, readings).cells == 0


def test_a_reading_has_the_number_of_crossed_cells_and_the_hit() -> None:
    laid = ray_table(3.0, 4)
    cases: list[tuple[int, list[int]]] = [
        (0, [FREE, UNKNOWN, UNKNOWN, UNKNOWN]),
        (2, [FREE, FREE, FREE, UNKNOWN]),
        (3, [FREE, FREE, FREE, FREE]),
        (HIT, [FREE, OCCUPIED, UNKNOWN, UNKNOWN]),
        (2 | HIT, [FREE, FREE, FREE, OCCUPIED]),
        (NONE, [FREE, UNKNOWN, UNKNOWN, UNKNOWN]),
    ]
    for reading, row in cases:
        grid = np.zeros((1, 4), np.uint8)
        draw(grid, laid, 0, 0, np.array([reading, NONE, NONE, NONE], np.uint16))
        assert grid.tolist() == [row]


def test_a_change_has_the_box_of_the_changed_cells() -> None:
    grid = np.zeros((9, 9), np.uint8)
    change = draw(grid, ray_table(2.0, 4), 4, 5, np.array([2, 1 | HIT, HIT, 0], np.uint16))
    assert change == GridChange(6, (3, 5, 7, 8))


@given(st.binary(min_size=1, max_size=800))
def test_fragments_put_together_are_the_scan(data: bytes) -> None:
    pieces = fragments(data)
    assert all(len(piece) <= 64 for piece in pieces)
    read: list[Any] = [decode(piece) for piece in pieces]
    assert all(len(packets) == 1 and isinstance(packets[0], Fragment) for packets in read)
    assert b"".join(packets[0].data for packets in read) == data


def test_a_scan_of_360_beams_takes_twelve_fragments() -> None:
    pieces = fragments(bytes(724))
    assert [len(piece) for piece in pieces] == [*11 * [64], 33]


@given(seeds, st.integers(1, 20))
def test_a_longer_ray_table_draws_the_same_scan(seed: int, more: int) -> None:
    readings = readings_of(seed)
    assume((readings != NONE).any())
    short, long = np.zeros((40, 40), np.uint8), np.zeros((40, 40), np.uint8)
    draw(short, FAN, 20, 20, readings)
    draw(long, ray_table(6.0 + more, 40), 20, 20, readings)
    assert short.tolist() == long.tolist()


def test_cells_driven_over_become_free_and_no_known_cell_changes() -> None:
    grid = np.array([[0, 0, 0, 0], [0, 1, 2, 0], [0, 0, 0, 0]], np.uint8)
    blind = np.full(40, NONE, np.uint16)
    driven = np.array([[1, 1], [2, 1], [3, 2], [3, 2], [1, 0], [4, 1], [1, -1]], np.int32)
    change = draw(grid, FAN, 1, 1, blind, driven)
    assert grid.tolist() == [[0, 1, 0, 0], [0, 1, 2, 0], [0, 0, 0, 1]]
    assert change == GridChange(2, (1, 0, 4, 3))
    assert draw(grid, FAN, 1, 1, blind, driven).cells == 0


sizes = st.lists(st.integers(1, 63), max_size=6)


@given(sizes, st.integers(1, 70), st.integers(0, 70), streams)
def test_joined_fragments_are_the_message_and_end_with_it(
    parts: list[int], size: int, held: int, others: list[AnyPacket]
) -> None:
    held %= size
    pieces = [bytes([number]) * part for number, part in enumerate(parts)]
    frame = encode(map(Fragment, pieces))
    assert contents(frame) == b"".join(pieces)
    at, fits = held, True
    for part in parts:
        at += part
        fits = fits and at <= size
        at %= size
    if fits:
        assert contents(frame, size, held) == b"".join(pieces)
    else:
        with pytest.raises(ProtocolError, match=f"the {size} bytes"):
            contents(frame, size, held)
    if not all(isinstance(other, Fragment) for other in others):
        with pytest.raises(ProtocolError, match="expected a packet of kind scan"):
            contents(frame + encode(others))
