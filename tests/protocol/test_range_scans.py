"""Range scans: the binary form, and where beams end."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.errors import ProtocolError
from protocol.range_scans import (
    NO_MEASUREMENT,
    NOTHING,
    TURN,
    UNIT,
    Laser,
    RangeScan,
    beam_ends,
    decode_range_scan,
    encode_range_scan,
    range_scan_size,
    smoothed,
)

LASER = Laser(7, -TURN // 4, TURN // 2, 8000)


@given(
    st.tuples(st.integers(-1000, 500_000), st.integers(-1000, 500_000)),
    st.integers(0, TURN - 1),
    st.lists(st.integers(0, 0xFFFF), min_size=7, max_size=7),
)
def test_a_scan_survives_its_binary_form(place: tuple[int, int], heading: int, ranges: list[int]) -> None:
    data = encode_range_scan(RangeScan(place, heading, np.array(ranges, np.uint16)))
    assert len(data) == range_scan_size(LASER)
    scan = decode_range_scan(data, LASER)
    assert (scan.place, scan.heading, scan.ranges.tolist()) == (place, heading, ranges)
    assert (scan.x, scan.y) == (place[0] // UNIT, place[1] // UNIT)


def test_a_wrong_length_or_position_is_refused() -> None:
    with pytest.raises(ProtocolError, match="instead of 24"):
        decode_range_scan(b"\0" * 23, LASER)
    far = RangeScan((1 << 30, 0), 0, np.zeros(7, np.uint16))
    with pytest.raises(ProtocolError, match="outside any grid"):
        decode_range_scan(encode_range_scan(far), LASER)


def test_beams_end_where_trigonometry_says() -> None:
    ranges = np.array([1000, NO_MEASUREMENT, 2500, NOTHING, 8000, 8001, 40], np.uint16)
    scan = RangeScan((10_000, 20_000), 9000, ranges)
    ends, hits = beam_ends(scan, LASER, 0.05)
    measured = np.flatnonzero(ranges)
    assert hits.tolist() == [True, True, False, True, False, True]
    for (x, y), beam in zip(ends.tolist(), measured.tolist(), strict=True):
        angle = 2 * math.pi * (9000 + int(LASER.angles[beam])) / TURN
        length = min(int(ranges[beam]), LASER.reach_mm) / 50 * UNIT
        assert x == pytest.approx(10_000 + length * math.cos(angle), abs=3)
        assert y == pytest.approx(20_000 + length * math.sin(angle), abs=3)


def test_beams_cover_the_field_of_view() -> None:
    assert LASER.angles.tolist()[0] == -TURN // 4
    assert LASER.angles.tolist()[-1] == TURN // 4


ALL_AROUND = Laser(8, 0, TURN * 7 // 8, 8000)


@pytest.mark.parametrize(("laser", "wraps"), [(Laser(8, 0, TURN // 2, 8000), False), (ALL_AROUND, True)])
@given(ranges=st.lists(st.sampled_from([NO_MEASUREMENT, 100, 101, 250, NOTHING]), min_size=8, max_size=8))
def test_a_smoothed_range_is_the_median_of_three_measured_ones(
    laser: Laser, wraps: bool, ranges: list[int]
) -> None:
    scan = smoothed(RangeScan((5, 6), 7, np.array(ranges, np.uint16)), laser)
    assert (scan.place, scan.heading) == ((5, 6), 7)
    for beam, found in enumerate(scan.ranges.tolist()):
        three = [ranges[beam - 1], ranges[beam], ranges[(beam + 1) % 8]]
        changes = NO_MEASUREMENT not in three and (wraps or 0 < beam < 7)
        assert found == (sorted(three)[1] if changes else ranges[beam])
