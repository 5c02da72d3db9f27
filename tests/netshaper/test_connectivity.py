"""Who hears whom: a disc, the same from both sides."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from netshaper.connectivity import in_range

places = st.dictionaries(
    st.integers(0, 20), st.tuples(st.integers(0, 30), st.integers(0, 30)), min_size=1, max_size=12
)


@given(places, st.floats(0, 50) | st.integers(0, 50).map(float))
def test_a_robot_hears_exactly_those_within_the_range(
    cells: dict[int, tuple[int, int]], range_cells: float
) -> None:
    heard = in_range(cells, range_cells)
    assert list(heard) == sorted(cells)
    for one, peers in heard.items():
        assert peers == [
            other
            for other in sorted(cells)
            if other != one and math.dist(cells[one], cells[other]) <= range_cells
        ]


@given(places, st.floats(0, 50))
def test_hearing_is_mutual(cells: dict[int, tuple[int, int]], range_cells: float) -> None:
    heard = in_range(cells, range_cells)
    assert all(one in heard[other] for one, peers in heard.items() for other in peers)


def test_a_robot_exactly_at_the_range_is_heard() -> None:
    assert in_range({0: (0, 0), 1: (3, 4)}, 5.0) == {0: [1], 1: [0]}
    assert in_range({0: (0, 0), 1: (3, 4)}, math.nextafter(5.0, 0)) == {0: [], 1: []}


@pytest.mark.parametrize("count", [1, 3])
def test_without_a_limit_everyone_hears_everyone(count: int) -> None:
    cells = {robot: (2000 * robot, 0) for robot in range(count)}
    assert in_range(cells, math.inf) == {r: [o for o in range(count) if o != r] for r in range(count)}


def test_at_range_0_only_robots_in_one_cell_would_hear_each_other() -> None:
    assert in_range({0: (1, 1), 1: (1, 2)}, 0.0) == {0: [], 1: []}
