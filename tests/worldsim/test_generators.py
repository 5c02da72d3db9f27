"""Every generated environment is valid, deterministic, and described; parameters are checked."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from protocol.grid import FREE, OCCUPIED
from tests.worldsim.building_measures import ALL_AROUND, check_enclosed_and_connected
from worldsim.generators import describe, make, names
from worldsim.maps import MapError

ALIKE_FOR_ALL_SEEDS = {
    "em",
    "leader-obstacles",
    "leader-trap",
    "leader-rooms",
    "two-circles",
    "burgard-five-rooms",
    "burgard-two-rooms",
    *(name for name in names() if name.startswith("hilbert")),
}
WITH_SOLID_OBJECTS = {
    "two-circles",
    "unstructured",
    "mixed",
    "potholes",
    "office-obstacles",
    "campus",
    "burgard-unstructured",
    "warehouse",
    "caves",
    "wings",
    "office-campus",
}
SOURCES = ("Meier", "Faigl", "Al-khawaldah", "leader paper", "Burgard", "Roodbergen", "Murmur")


@pytest.mark.parametrize("name", names())
def test_every_environment_is_enclosed_and_connected(name: str) -> None:
    for seed in range(3):
        check_enclosed_and_connected(make(name, seed))


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(names()), st.integers(0, 2**40), st.sampled_from([0.1, 0.15, 0.25, 0.4]))
def test_every_seed_and_resolution_gives_an_enclosed_and_connected_world(
    name: str, seed: int, resolution: float
) -> None:
    world = make(name, seed, resolution=resolution)
    assert world.resolution == resolution
    check_enclosed_and_connected(world)


@pytest.mark.parametrize("name", names())
def test_a_robot_of_half_a_meter_gets_everywhere(name: str) -> None:
    """Less than a thousandth of the places where it fits may be niches that it cannot reach."""
    world = make(name, seed=5, resolution=0.1)
    fits = ndimage.distance_transform_edt(world.cells == FREE) > 2.5
    areas = np.bincount(ndimage.label(fits)[0].ravel())[1:]
    assert areas.max() >= 0.999 * areas.sum()


@pytest.mark.parametrize("name", names())
def test_the_same_seed_draws_the_same_world_and_another_seed_another(name: str) -> None:
    first, again, other = make(name, 1), make(name, 1), make(name, 2)
    assert first.cells.tobytes() == again.cells.tobytes()
    assert (first.cells.tobytes() == other.cells.tobytes()) == (name in ALIKE_FOR_ALL_SEEDS)
    assert first.name == name
    assert first.origin == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("name", names())
def test_every_environment_is_described_in_one_line_with_its_source(name: str) -> None:
    line = describe(name)
    assert "\n" not in line
    assert len(line) <= 110
    assert any(source in line for source in SOURCES)


@pytest.mark.parametrize("name", sorted(set(names()) - WITH_SOLID_OBJECTS))
def test_walls_are_one_or_two_cells_thick(name: str) -> None:
    for seed in range(3):
        walls = make(name, seed).cells == OCCUPIED
        assert not ndimage.binary_erosion(walls, ALL_AROUND).any()


def test_an_unknown_name_lists_the_known_ones() -> None:
    for ask in (make, describe):
        with pytest.raises(
            MapError,
            match=r"unknown map 'offce'; did you mean office[?] There are: unstructured, mixed",
        ):
            ask("offce")


@pytest.mark.parametrize(
    ("name", "parameters", "message"),
    [
        ("office", {"seed": -1}, "seed is -1; give 0 or more"),
        ("office", {"rooms": 3}, "office has no parameter 'rooms'; it has width_m, height_m, resolution"),
        ("hilbert-2", {"width_m": 3}, "hilbert-2 has no parameter 'width_m'; it has side_m, resolution"),
        (
            "hilbert-2",
            {"side_m": 1.0},
            r"side_m is 1\.0 m; with cells of 0\.1 m it must be at least 1\.6 m and at most 204\.8 m, 2048",
        ),
        (
            "leader-trap",
            {"resolution": 0.0},
            r"resolution is 0\.0; it must be above 0 and at most 0\.4 m per cell",
        ),
        ("em", {"resolution": float("nan")}, "resolution is nan"),
        ("office", {"resolution": 0.5}, r"resolution is 0\.5; it must be above 0 and at most 0\.4"),
        (
            "em",
            {"resolution": 0.001},
            r"width_m is 21\.0 m; with cells of 0\.001 m it must be at least 2 m and at most 2\.048 m",
        ),
        (
            "mixed",
            {"height_m": 5.0},
            r"height_m is 5\.0 m; with cells of 0\.1 m it must be at least 18 m and at most 204\.8 m",
        ),
        ("mixed", {"width_m": float("nan")}, "width_m is nan"),
        ("office", {"clutter": 1}, "office has no parameter 'clutter'; it has width_m, height_m, resolution"),
        ("warehouse", {"clutter": 21}, "clutter is 21; it must be 0 to 20 pallets per 100 square meters"),
        ("warehouse", {"clutter": float("nan")}, "clutter is nan; it must be 0 to 20 pallets"),
        ("caves", {"clutter": -1}, "clutter is -1; it must be 0 to 20 rocks per 100 square meters"),
        ("maze", {"clutter": 21}, "clutter is 21; it must be 0 to 20 crates"),
        ("wings", {"clutter": 21}, "clutter is 21; it must be 0 to 20 pieces of furniture"),
        ("office-campus", {"clutter": 21}, "clutter is 21; it must be 0 to 20 trees"),
        ("caves", {"width_m": 14.0}, r"width_m is 14\.0 m; .* at least 15 m"),
        ("maze", {"height_m": 7.0}, r"height_m is 7\.0 m; .* at least 8 m"),
        ("wings", {"height_m": 29.0}, r"height_m is 29\.0 m; .* at least 30 m"),
        ("office-campus", {"width_m": 29.0}, r"width_m is 29\.0 m; .* at least 30 m"),
    ],
)
def test_error_states_the_valid_range_of_a_parameter(
    name: str, parameters: dict[str, Any], message: str
) -> None:
    with pytest.raises(MapError, match=message):
        make(name, **parameters)


def test_parameters_change_the_size() -> None:
    world = make("unstructured", width_m=30.0, height_m=20.0, resolution=0.2)
    assert (world.width, world.height, world.resolution) == (150, 100, 0.2)
