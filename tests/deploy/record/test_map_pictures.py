"""Pictures of maps: errors of each robot's map, starts and dots along the paths, all on one page."""

from __future__ import annotations

import io
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from deploy.record import colors
from deploy.record.map_errors import (
    FALSE_WALL,
    IRRELEVANT,
    RIGHT,
    UNSEEN,
    WALL,
    WRONG_FREE,
    compare,
    share_correct,
)
from deploy.record.map_pictures import PAGE_SHAPE, draw_map, maps_figure, mark_steps
from deploy.record.number_texts import percent
from deploy.record.records import Records
from deploy.record.summary import summarize
from deploy.run.in_memory import MemoryRun
from deploy.scenario import plan as plans
from deploy.scenario.scenario import parse
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from tests.deploy.figure_checks import assert_text_fits
from tests.deploy.small_run import hall, small_plan, small_run

pytestmark = pytest.mark.slow

grids = arrays(np.uint8, (4, 5), elements=st.integers(0, 2))


@given(grids, grids, arrays(np.bool_, (4, 5)))
def test_each_cell_of_a_map_has_exactly_one_class(
    grid: Grid, truth: Grid, chosen: np.ndarray[tuple[int, int], np.dtype[np.bool_]]
) -> None:
    reachable = chosen & (truth == FREE)
    expected = np.zeros_like(grid)
    for at in np.ndindex(grid.shape):
        expected[at] = {
            UNKNOWN: UNSEEN if reachable[at] else IRRELEVANT,
            FREE: RIGHT if truth[at] == FREE else WRONG_FREE,
            OCCUPIED: FALSE_WALL if truth[at] == FREE else WALL,
        }[int(grid[at])]
    errors = compare(grid, truth, reachable)
    assert (errors == expected).all()
    if reachable.any():
        assert share_correct(errors, reachable) == (grid == FREE)[reachable].mean()


def drawn(robots: int) -> tuple[Figure, Records]:
    plan = small_plan(robots=robots, map_encoding="none", steps=4)
    records = MemoryRun(plan).complete()
    return maps_figure(plan, records, summarize(plan, records, 1.0)), records


@pytest.mark.parametrize("robots", [1, 7, 40])
def test_any_number_of_robots_fits_a_page_and_no_panel_hides_another(robots: int) -> None:
    figure, records = drawn(robots)
    boxes = [axes.get_position() for axes in figure.axes]
    assert len(boxes) == 2 + robots
    assert len(records.planning) == robots
    assert all(0 <= box.x0 < box.x1 <= 1 and 0 <= box.y0 < box.y1 <= 1 for box in boxes)
    for first, one in enumerate(boxes):
        for other in boxes[first + 1 :]:
            apart = one.x1 <= other.x0 or other.x1 <= one.x0 or one.y1 <= other.y0 or other.y1 <= one.y0
            assert apart
    width, height = figure.get_size_inches()
    assert PAGE_SHAPE / 2 < width / height < 2 * PAGE_SHAPE


def test_the_title_has_the_bytes_that_a_small_team_transmits() -> None:
    plan = small_plan(robots=2, steps=2)
    records = MemoryRun(plan).complete()
    summary = summarize(plan, records, 1.0)
    title = maps_figure(plan, records, summary).get_suptitle()
    assert title.endswith(f"; 2 steps, {summary['bytes']['total']} B transmitted")


@pytest.mark.parametrize(
    ("share", "decimals", "text"),
    [
        (1, 1, "100.0 %"),
        (0.99999, 1, "99.9 %"),
        (0.99999, 2, "99.99 %"),
        (0.5, 2, "50.00 %"),
        (1 - 1e-15, 2, "100.00 %"),
    ],
)
def test_a_share_is_100_percent_only_if_it_is_complete(share: float, decimals: int, text: str) -> None:
    assert percent(share, decimals) == text


def test_a_panel_shows_the_errors_of_its_robots_map() -> None:
    plan, records = small_plan(), small_run().records
    reachable = plan.make_world().reachable
    figure = maps_figure(plan, records, small_run().summary)
    for robot, panel in zip(sorted(records.planning), figure.axes[2:], strict=True):
        errors = compare(records.planning[robot], plan.map.cells, reachable)
        assert (shown(panel) == errors).all()
        assert panel.get_title().startswith(
            f"robot {robot}: {100 * share_correct(errors, reachable):.1f} % correct"
        )
    file = io.BytesIO()
    figure.savefig(file, dpi=60)
    pixels = np.array(Image.open(file).convert("RGB")).reshape(-1, 3)
    assert (pixels == colors.UNSEEN).all(axis=1).sum() > 1000
    words = [text.get_text() for text in figure.legends[0].get_texts()]
    assert words == [
        "start", "end", "every 5 steps", "false wall", "unknown", "false floor",
        "wall",
    ]  # fmt: skip


def shown(panel: Axes) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    (image,) = panel.images
    array = image.get_array()
    assert array is not None
    return np.asarray(array, np.uint8)


@pytest.mark.parametrize(("last", "every"), [(1, 1), (9, 1), (40, 5), (154, 20), (1000, 100), (2001, 500)])
def test_paths_have_about_ten_dots_at_round_steps(last: int, every: int) -> None:
    assert mark_steps(last) == every


@pytest.mark.parametrize(("width", "height"), [(60, 700), (700, 60)], ids=["tall", "wide"])
def test_titles_and_labels_fit_on_narrow_maps_with_long_names(
    tmp_path: Path, width: int, height: int
) -> None:
    settings = hall(tmp_path / f"{'the-plan-of-the-east-wing-of-the-hospital-' * 3}.png", height, width)
    plan = plans.make(parse(settings | {"robots": 4, "steps": 3}))
    records = MemoryRun(plan).complete()
    figure = maps_figure(plan, records, summarize(plan, records, 1.0))
    for number in figure.axes[0].texts:
        number.set_visible(False)  # robots that are close hide each other's numbers
    assert_text_fits(figure)
    draw_map(tmp_path / "map.png", plan.map)
    with Image.open(tmp_path / "map.png") as drawn_map:
        assert max(drawn_map.size) < 2000


def test_text_in_the_color_of_a_robot_is_readable_on_white() -> None:
    for robot in range(30):
        parts = np.array(colors.text_color(robot)) / 255
        linear = np.where(parts <= 0.03928, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
        assert 1.05 / (linear @ (0.2126, 0.7152, 0.0722) + 0.05) > 2.9


VISIONS = {
    "common": np.eye(3),
    "deuteranopia": np.array([[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]]),
    "protanopia": np.array([[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]]),
    "tritanopia": np.array([[1.256, -0.077, -0.179], [-0.078, 0.931, 0.148], [0.005, 0.691, 0.304]]),
}
"""How linear RGB appears with each kind of color vision (Machado, Oliveira, and Fernandes 2009, severity 1)."""
XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


@pytest.mark.parametrize("vision", VISIONS)
def test_color_blind_readers_distinguish_the_robots_of_small_teams(vision: str) -> None:
    parts = np.array(colors.ROBOTS[:6]) / 255
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    x, y, z = np.cbrt(XYZ @ np.clip(VISIONS[vision] @ linear.T, 0, 1) / [[0.9505], [1.0], [1.089]])
    lab = np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)]).T
    apart = [float(np.linalg.norm(one - other)) for one, other in combinations(lab, 2)]
    assert min(apart) > 15
