"""Lasers with errors: exact distances compared with small steps along the beam, and the statistics of the errors."""

from __future__ import annotations

import math

import numpy as np
import pytest

from agent.mapping.estimator import Estimator
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.keyed_random import keyed_random
from protocol.range_scans import NO_MEASUREMENT, NOTHING, TURN, UNIT, Laser, RangeScan, beam_ends
from worldsim.range_laser import RangeLaser
from worldsim.sensor_options import LaserOptions

LASER = Laser(360, 0, TURN - TURN // 360, 5000)
CELL = 0.1


def room(side: int = 60) -> Grid:
    """Return a square room with walls of one cell, and a pillar."""
    truth = np.full((side, side), FREE, np.uint8)
    truth[[0, -1]] = truth[:, [0, -1]] = OCCUPIED
    truth[20:24, 35:39] = OCCUPIED
    return truth


def measure(
    options: LaserOptions, truth: Grid, place: tuple[float, float], heading: int = 0, number: int = 0
) -> np.ndarray:
    teammates = np.zeros(truth.shape, np.bool_)
    random = keyed_random(1, "laser", number)
    return RangeLaser(options, LASER, CELL).ranges(truth, teammates, place, heading, random)


def middle_of_wall(truth: Grid, x: float, y: float, angle: float) -> float:
    """Return the distance to the middle of a beam's way through the first wall cell, from all borders it crosses."""
    dx, dy = math.cos(angle), math.sin(angle)
    borders = np.arange(len(truth) + 1)
    crossed = np.sort(np.concatenate([(borders - x) / dx, (borders - y) / dy]))
    crossed = crossed[crossed > 0]
    middles = (crossed[:-1] + crossed[1:]) / 2
    return next(at for at in middles.tolist() if truth[int(y + at * dy), int(x + at * dx)] != FREE)


def test_an_exact_laser_measures_to_the_middle_of_the_first_wall_cell() -> None:
    truth = room()
    ranges = measure(LaserOptions(), truth, (30.3, 28.7), heading=TURN // 7)
    for beam in range(0, 360, 7):
        angle = 2 * math.pi * ((TURN // 7 + LASER.angles[beam]) % TURN) / TURN
        middle = middle_of_wall(truth, 30.3, 28.7, angle)
        assert ranges[beam] / 1000 == pytest.approx(middle * CELL, abs=0.002)


def test_exact_ranges_reproduce_the_true_walls() -> None:
    truth, estimator = room(), Estimator(60, 60)
    for number, (x, y) in enumerate([(10, 10), (50, 12), (30, 45), (12, 50), (48, 40)]):
        scan = RangeScan(
            (x * UNIT + 128, y * UNIT + 128),
            0,
            measure(LaserOptions(), truth, (x + 0.5, y + 0.5), number=number),
        )
        estimator.add(*scan.place, *beam_ends(scan, LASER, CELL))
    known = estimator.states != UNKNOWN
    assert known.mean() > 0.9
    assert (estimator.states == truth)[known].mean() > 0.999


def test_the_range_error_has_the_given_deviation() -> None:
    truth = room()
    exact = measure(LaserOptions(), truth, (30.5, 30.5)).astype(float)
    for options, deviation in (
        (LaserOptions(range_error_m=0.03), lambda meters: np.full_like(meters, 0.03)),
        (LaserOptions(range_error_share=0.02), lambda meters: 0.02 * meters),
    ):
        errors = np.concatenate(
            [
                (measure(options, truth, (30.5, 30.5), number=number) - exact)
                / 1000
                / deviation(exact / 1000)
                for number in range(20)
            ]
        )
        assert abs(errors.mean()) < 0.05
        assert errors.std() == pytest.approx(1, abs=0.03)


def test_missing_and_short_beams_occur_as_often_as_given() -> None:
    truth, options = room(), LaserOptions(missing=0.1, short=0.2)
    exact = measure(LaserOptions(), truth, (30.5, 30.5))
    scans = np.array([measure(options, truth, (30.5, 30.5), number=number) for number in range(50)])
    assert (scans == NO_MEASUREMENT).mean() == pytest.approx(0.1, abs=0.01)
    assert ((scans < exact) & (scans != NO_MEASUREMENT)).mean() == pytest.approx(0.2, abs=0.015)


def test_mixed_ranges_lie_between_the_surfaces_of_an_edge() -> None:
    truth = room()
    exact = measure(LaserOptions(), truth, (30.5, 30.5)).astype(int)
    mixed = measure(LaserOptions(mixed=1.0), truth, (30.5, 30.5)).astype(int)
    ahead = np.append(exact[1:], exact[-1])
    edges = np.abs(ahead - exact) > 300
    assert edges.any()
    assert (mixed == exact)[~edges].all()
    assert (np.minimum(exact, ahead) <= mixed).all()
    assert (mixed <= np.maximum(exact, ahead)).all()
    assert (mixed != exact)[edges].all()


def test_ranges_outside_the_limits_have_no_measurement_or_show_nothing() -> None:
    truth = room()
    near = measure(LaserOptions(min_range_m=2.0, max_range_m=2.5), truth, (30.5, 30.5))
    assert set(near[near < 2000].tolist()) <= {NO_MEASUREMENT}
    assert NOTHING in near


def test_teammates_are_filtered_out() -> None:
    truth, teammates = room(), np.zeros((60, 60), np.bool_)
    teammates[30, 32] = True
    ranges = RangeLaser(LaserOptions(), LASER, CELL).ranges(
        truth, teammates, (30.5, 30.5), 0, keyed_random(1, "laser")
    )
    assert ranges[0] == NO_MEASUREMENT
    assert ranges[180] > 0


def test_no_beam_beside_a_teammate_measures_behind_the_walls() -> None:
    truth, teammates = room(), np.zeros((60, 60), np.bool_)
    teammates[[30, 25, 36], [36, 30, 30]] = True
    options = LaserOptions(mixed=1.0)
    laser = RangeLaser(options, LASER, CELL)
    exact = measure(LaserOptions(), truth, (30.5, 30.5)).astype(int)
    ranges = laser.ranges(truth, teammates, (30.5, 30.5), 0, keyed_random(1, "laser")).astype(int)
    assert (ranges == NO_MEASUREMENT).any()
    assert (ranges <= np.maximum(exact, np.append(exact[1:], exact[-1]))).all()


def test_no_range_ends_in_empty_space_at_the_end_of_the_reach() -> None:
    ranges = measure(LaserOptions(mixed=1.0, max_range_m=2.5), room(), (30.5, 30.5))
    walls = ranges[ranges != NOTHING]
    exact = measure(LaserOptions(), room(), (30.5, 30.5))[ranges != NOTHING]
    assert len(walls)
    assert (np.abs(walls.astype(int) - exact) <= 1).mean() > 0.9


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"missing": 1.5}, "missing = 1.5: must be 0 to 1$"),
        ({"missing": 0.6, "short": 0.6}, "together"),
        ({"range_error_m": -1}, "0 to 1 m"),
        ({"min_range_m": 3, "max_range_m": 2}, "must exceed"),
        ({"beams": 10**6}, "0 to"),
    ],
)
def test_impossible_lasers_are_refused(values: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        LaserOptions(**values)  # type: ignore[arg-type]
