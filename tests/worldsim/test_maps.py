"""Maps on disk: reading files of ROS, round trips, and error messages for invalid files."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from PIL import Image

from protocol.grid import FREE, MAX_SIDE, OCCUPIED, UNKNOWN
from worldsim.maps import Map, MapError, load, save, to_cell, to_world

REAL_MAPS = Path(os.environ.get("MURMUR_MAPS", Path(__file__).parents[3] / "shared" / "maps"))

ENTRIES = {
    "image": "world.pgm",
    "resolution": 0.1,
    "origin": [0.0, 0.0, 0.0],
    "negate": 0,
    "occupied_thresh": 0.65,
    "free_thresh": 0.196,
}
WHITE, GRAY, BLACK = 254, 205, 0
PICTURE = b"P5\n3 2\n255\n" + bytes([WHITE, GRAY, BLACK, WHITE, WHITE, WHITE])
CELLS = [[FREE, UNKNOWN, OCCUPIED], [FREE, FREE, FREE]]

worlds = st.builds(
    lambda cells, resolution, x, y: Map("world", cells, resolution, (x, y, 0.0)),
    arrays.arrays(
        np.uint8, arrays.array_shapes(min_dims=2, max_dims=2, max_side=30), elements=st.integers(0, 2)
    ).filter(lambda cells: (cells == FREE).any()),
    st.floats(1e-4, 100),
    st.floats(-1e6, 1e6),
    st.floats(-1e6, 1e6),
)


def write(folder: Path, picture: bytes = PICTURE, without: str = "", **changes: object) -> Path:
    """Write a map, with `changes` of its entries."""
    entries = {key: value for key, value in (ENTRIES | changes).items() if key != without}
    (folder / "world.pgm").write_bytes(picture)
    path = folder / "world.yaml"
    path.write_text(yaml.safe_dump(entries))
    return path


def save_picture(folder: Path, picture: Image.Image) -> bytes:
    picture.save(folder / "colors.png")
    return (folder / "colors.png").read_bytes()


def test_a_map_reads_white_as_free_black_as_occupied_and_gray_as_unknown(tmp_path: Path) -> None:
    world = load(write(tmp_path, resolution=0.05, origin=[-1.5, 2, 0]))
    assert world.name == "world"
    assert world.cells.tolist() == CELLS
    assert world.cells.dtype == np.uint8
    assert (world.width, world.height) == (3, 2)
    assert world.resolution == 0.05
    assert world.origin == (-1.5, 2.0, 0.0)
    assert world.diagonal_m == pytest.approx(0.05 * math.sqrt(13))


@pytest.mark.parametrize(
    "picture",
    [
        b"P2\n# made by hand\n3 2\n255\n254 205 0\n254 254 254\n",
        b"P2 3 2 100 100 80 0 100 100 100",
        b"P5\n3 2\n65535\n" + np.array([[65535, 52600, 0], [65535, 65535, 65535]], ">u2").tobytes(),
    ],
    ids=["text", "another white", "16 bits"],
)
def test_every_form_of_pgm_reads_alike(tmp_path: Path, picture: bytes) -> None:
    assert load(write(tmp_path, picture)).cells.tolist() == CELLS


def test_a_cell_exactly_at_a_threshold_is_unknown(tmp_path: Path) -> None:
    picture = b"P5\n5 1\n255\n" + bytes([203, 204, 205, 102, 101])
    world = load(write(tmp_path, picture, free_thresh=0.2, occupied_thresh=0.6))
    assert world.cells.tolist() == [[UNKNOWN, UNKNOWN, FREE, UNKNOWN, OCCUPIED]]


@pytest.mark.parametrize("negate", [1, True])
def test_negate_swaps_black_and_white(tmp_path: Path, negate: object) -> None:
    picture = b"P5\n3 1\n255\n" + bytes([0, 50, 255])
    assert load(write(tmp_path, picture, negate=negate)).cells.tolist() == [[FREE, UNKNOWN, OCCUPIED]]


def test_colors_are_averaged(tmp_path: Path) -> None:
    colors = np.array([[(255, 255, 255), (255, 0, 0), (0, 0, 0), (255, 255, 150)]], np.uint8)
    world = load(write(tmp_path, save_picture(tmp_path, Image.fromarray(colors))))
    assert world.cells.tolist() == [[FREE, OCCUPIED, OCCUPIED, FREE]]


def test_opacity_counts_as_a_fourth_color_as_it_does_for_map_server(tmp_path: Path) -> None:
    colors = np.array([[(255, 255, 255, 255), (0, 0, 0, 255), (255, 255, 255, 0), (0, 0, 0, 0)]], np.uint8)
    world = load(write(tmp_path, save_picture(tmp_path, Image.fromarray(colors))))
    assert world.cells.tolist() == [[FREE, OCCUPIED, UNKNOWN, OCCUPIED]]


@pytest.mark.parametrize("mode", ["1", "P"])
def test_pictures_of_few_colors_are_read(tmp_path: Path, mode: str) -> None:
    picture = Image.fromarray(np.array([[255, 0, 255]], np.uint8)).convert(mode)
    assert load(write(tmp_path, save_picture(tmp_path, picture))).cells.tolist() == [[FREE, OCCUPIED, FREE]]


def test_numbers_are_read_as_ros_reads_them(tmp_path: Path) -> None:
    path = write(tmp_path)
    path.write_text(path.read_text().replace("resolution: 0.1", "resolution: 1e-1"))
    assert load(path).resolution == 0.1


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(worlds)
def test_saved_map_is_loaded_with_every_cell(tmp_path: Path, world: Map) -> None:
    path = tmp_path / "world.yaml"
    save(world, path)
    again = load(path)
    assert np.array_equal(again.cells, world.cells)
    assert again.cells.dtype == np.uint8
    assert (again.name, again.resolution, again.origin) == (world.name, world.resolution, world.origin)


def test_real_maps_keep_every_cell_through_save_and_load(tmp_path: Path) -> None:
    paths = sorted(REAL_MAPS.glob("*.yaml"))
    if not paths:
        pytest.skip(f"no maps in {REAL_MAPS}; set MURMUR_MAPS to a folder of map_server maps")
    for path in paths:
        world = load(path)
        save(world, tmp_path / path.name)
        again = load(tmp_path / path.name)
        assert np.array_equal(again.cells, world.cells)
        assert (again.name, again.resolution, again.origin) == (world.name, world.resolution, world.origin)


def test_a_save_that_fails_leaves_the_old_map_and_nothing_else(tmp_path: Path) -> None:
    path = write(tmp_path)
    path = path.rename(tmp_path / "taken.yaml")
    (tmp_path / "taken.png").mkdir()
    before = {file: file.read_bytes() for file in tmp_path.iterdir() if file.is_file()}
    with pytest.raises(OSError, match="taken"):
        save(load(path), path)
    assert {file: file.read_bytes() for file in tmp_path.iterdir() if file.is_file()} == before


def test_the_origin_is_the_outer_corner_of_the_lower_left_cell(tmp_path: Path) -> None:
    world = load(write(tmp_path, resolution=0.5, origin=[10.0, 20.0, 0.0]))
    lower_left = (0, world.height - 1)
    assert to_world(world, lower_left[0] - 0.5, lower_left[1] + 0.5) == (10.0, 20.0)
    assert to_world(world, *lower_left) == (10.25, 20.25)
    assert to_world(world, 0, 0) == (10.25, 20.75)  # the upper left cell is higher up in ROS' frame
    assert to_cell(world, 11.4, 20.1) == pytest.approx((2.3, 1.3))


@given(worlds, st.data())
def test_every_cell_comes_back_from_the_metric_frame(world: Map, data: st.DataObject) -> None:
    x = data.draw(st.integers(0, world.width - 1))
    y = data.draw(st.integers(0, world.height - 1))
    back_x, back_y = to_cell(world, *to_world(world, x, y))
    far = max(map(abs, world.origin)) / world.resolution
    assert (back_x, back_y) == pytest.approx((x, y), abs=1e-9 + 1e-15 * far)


@pytest.mark.parametrize("key", ["image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh"])
def test_a_missing_key_is_named(tmp_path: Path, key: str) -> None:
    with pytest.raises(MapError, match=rf"world\.yaml: {key} is missing"):
        load(write(tmp_path, without=key))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"image": 3}, "image is 3, not the name of a file"),
        ({"image": ""}, "image is '', not the name of a file"),
        ({"image": "gone.pgm"}, "gone.pgm: cannot be read"),
        ({"image": "."}, "cannot be read"),
        ({"resolution": 0}, r"resolution is 0\.0, not a number of meters per cell above 0"),
        ({"resolution": -0.1}, r"resolution is -0\.1"),
        ({"resolution": math.nan}, "resolution is nan"),
        ({"resolution": math.inf}, "resolution is inf"),
        ({"resolution": "fine"}, "resolution is 'fine', not a number"),
        ({"resolution": True}, "resolution is True, not a number"),
        ({"resolution": [0.1]}, r"resolution is \[0\.1\], not a number"),
        ({"resolution": None}, "resolution is None, not a number"),
        ({"resolution": 10**400}, "not a number"),
        ({"origin": [0, 0]}, r"origin is \[0, 0\], not \[x in meters, y in meters, yaw in radians\]"),
        ({"origin": "here"}, "origin is 'here', not"),
        ({"origin": [0, "a", 0]}, "origin is 'a', not a number"),
        ({"origin": [math.nan, 0, 0]}, r"origin is \[nan, 0\.0, 0\.0\], not three numbers of 1e\+08 at most"),
        ({"origin": [0, 0, 0.5]}, r"origin is rotated by 0\.5 rad; rotate the picture instead"),
        ({"negate": 2}, r"negate is 2; give 0 \(white is free\) or 1 \(black is free\)"),
        ({"negate": "no"}, "negate is 'no'"),
        ({"negate": []}, r"negate is \[\]"),
        ({"occupied_thresh": 65}, r"occupied_thresh is 65\.0; it must lie between 0 and 1"),
        ({"free_thresh": -0.1}, r"free_thresh is -0\.1; it must lie between 0 and 1"),
        ({"free_thresh": math.nan}, "free_thresh is nan; it must lie between 0 and 1"),
        ({"free_thresh": 0.7}, r"free_thresh 0\.7 is above occupied_thresh 0\.65"),
        ({"mode": "scale"}, "mode is 'scale'; only trinary is supported"),
        ({"mode": "raw"}, "mode is 'raw'; only trinary is supported"),
    ],
)
def test_error_states_the_invalid_entry_and_a_remedy(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(MapError, match=message) as caught:
        load(write(tmp_path, **changes))
    assert str(tmp_path) in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("image: [", "is not YAML"),
        ("image: \x00", "is not YAML"),
        ("", "contains no `key: value` lines"),
        ("- image", "contains no `key: value` lines"),
        ("!!python/object/apply:os.getcwd []", "is not YAML"),
    ],
)
def test_a_broken_yaml_file_is_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "world.yaml"
    path.write_text(text)
    with pytest.raises(MapError, match=rf"world\.yaml: {message}"):
        load(path)


def test_a_missing_yaml_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(MapError, match=r"gone\.yaml: cannot be read \(No such file or directory\)"):
        load(tmp_path / "gone.yaml")


@pytest.mark.parametrize(
    ("picture", "message"),
    [
        (b"", "is empty"),
        (b"GIF89a", "is not a complete PGM or PNG picture"),
        (b"P5\n0 2\n255\n", "is not a complete PGM or PNG picture"),
        (b"P5\n2", "is not a complete PGM or PNG picture"),
        (b"P2\n2 1\n255\n1 x", "is not a complete PGM or PNG picture"),
        (b"P2\n2 1\n255\n1 999", "is not a complete PGM or PNG picture"),
        (b"Pf\n1 1\n-1.0\n" + bytes(4), "its gray values are fractions"),
        (b"P5\n2 2\n255\n" + bytes(4), "no cell is free; check negate and the thresholds"),
        (
            b"P5\n%d 1\n255\n" % (MAX_SIDE + 1),
            f"is {MAX_SIDE + 1} x 1 cells, and the maximum is {MAX_SIDE} x {MAX_SIDE}",
        ),
        (b"P5\n99999 99999\n255\n", f"has more than {MAX_SIDE} x {MAX_SIDE} cells"),
    ],
)
def test_error_names_an_invalid_picture(tmp_path: Path, picture: bytes, message: str) -> None:
    with pytest.raises(MapError, match=message) as caught:
        load(write(tmp_path, picture))
    assert "world" in str(caught.value)


@pytest.mark.parametrize("suffix", [".png", ".pgm"])
def test_truncated_picture_is_rejected(tmp_path: Path, suffix: str) -> None:
    cells = np.random.default_rng(0).integers(0, 3, (12, 9), np.uint8)
    if suffix == ".png":
        save(Map("world", cells, 0.1), tmp_path / "world.yaml")
    else:
        write(tmp_path, b"P5\n9 12\n255\n" + cells.tobytes())
    picture = tmp_path / f"world{suffix}"
    whole = picture.read_bytes()
    end_mark = 16 if suffix == ".png" else 0
    for length in range(len(whole) - end_mark):
        picture.write_bytes(whole[:length])
        with pytest.raises(MapError, match=rf"world\{suffix}: is "):
            load(tmp_path / "world.yaml")


@pytest.mark.parametrize(
    ("cells", "message"),
    [
        (np.ones(4, np.uint8), r"uint8 of shape \(4,\), not uint8 rows and columns"),
        (np.ones((2, 2)), "float64 of shape"),
        (np.ones((2, MAX_SIDE + 1), np.uint8), f"is {MAX_SIDE + 1} x 2 cells"),
        (np.full((2, 2), 3, np.uint8), "a cell has state 3; the states are 0 unknown, 1 free, 2 occupied"),
        (np.zeros((2, 2), np.uint8), "no cell is free"),
        (np.ones((0, 2), np.uint8), "no cell is free"),
    ],
)
def test_map_with_invalid_cells_is_rejected(cells: np.ndarray[Any, Any], message: str) -> None:
    with pytest.raises(MapError, match=message):
        Map("world", cells, 0.1)


def test_largest_map_is_accepted(tmp_path: Path) -> None:
    save(Map("world", np.ones((MAX_SIDE, MAX_SIDE), np.uint8), 0.1), tmp_path / "world.yaml")
    assert load(tmp_path / "world.yaml").width == MAX_SIDE
