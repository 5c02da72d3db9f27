"""The dashboard as people see it: in Rerun's own viewer, and in a real browser.

With ``MURMUR_PICTURES`` set to a folder, what was seen is kept there.
"""

from __future__ import annotations

import io
import json
import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from deploy.dashboard.layout import SERIES_SHARES
from deploy.dashboard.process import RECORDING
from deploy.dashboard.windows import Window
from deploy.record.colors import GROUPS, TEAM, robot_color
from deploy.record.run_directory import SUMMARY
from deploy.run.exploration import explore
from deploy.scenario.scenario import parse
from tests.system.browser import Browser
from tests.system.headless import settled_picture, viewer

pytest.importorskip("rerun", reason="Rerun is not installed: pip install 'murmur-robots[view]'")

VIEWS = [
    "True map [m]", "Help", "Transmitted [B/step]", "By type [%]", "Explored [%]", "Walls [%]",
    "Undelivered [log entries]", "Events",
]  # fmt: skip


def recorded(folder: Path, **settings: object) -> Path:
    """The recording of a run in memory."""
    explore(parse({"bus": "memory", **settings}), out=folder / "run", window=Window("file"))
    return folder / "run" / RECORDING


def keep(name: str, png: bytes) -> None:
    folder = os.environ.get("MURMUR_PICTURES")
    if folder:
        Path(folder, f"{name}.png").write_bytes(png)


def assert_shows_robots(png: bytes, robots: int) -> None:
    """The color of every robot, up to those whose maps are in another tab, is on the dashboard many times over."""
    pixels = np.array(Image.open(io.BytesIO(png)).convert("RGB")).reshape(-1, 3).astype(int)
    for robot in range(min(8, robots)):
        near = np.abs(pixels - robot_color(robot)).max(axis=1) <= 6
        assert near.sum() > 120, f"robot {robot} is hardly to be seen"


TOP_BAR, TITLE, TIME_BAR = 37, 32, 30
"""Rows of the bar above the panels, of a panel's title, and of the time panel below."""


def assert_is_to_be_read(png: bytes, *, light: bool, kinds: int = 4, top: int = TOP_BAR) -> None:
    """The theme is what was asked for, the team's curves stand out from it, and each bar has its caption above it."""
    picture = np.array(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)
    panels = picture[top:-TIME_BAR]
    lower = panels[int(0.6 * len(panels)) + TITLE :]
    wide = lower.shape[1]
    paper = np.median(lower.reshape(-1, 3), axis=0)
    assert (paper > 230).all() if light else (paper < 40).all()
    edges = [sum(SERIES_SHARES[:n]) * wide // sum(SERIES_SHARES) for n in range(len(SERIES_SHARES) + 1)]
    for left, right in (edges[0:2], edges[2:4]):
        curve = lower[:, left:right]
        assert (np.abs(curve - TEAM).max(axis=2) <= 30).sum() > 150, "the team's curve is hardly to be seen"
    panel = lower[:, edges[1] + 4 : edges[2] - 4]
    bars = 0
    for color in {group.color for group in GROUPS.values()}:
        off = np.abs(panel - color).max(axis=2)
        rows = np.flatnonzero((off <= 6).sum(axis=1) > 0.1 * panel.shape[1])
        if len(rows):
            bars += 1
            caption = off[max(0, rows[0] - 45) : rows[0] - 3] <= 60
            assert caption.sum() > 20, f"the bar of color {color} has no caption"
            assert not caption[:, [0, -1]].any(), "a caption is cut off"
    assert bars >= kinds


OUTLINES = {"map_encoding": "polygons", "strategy": "meier"}


@pytest.mark.parametrize(
    ("name", "robots", "more", "kinds"),
    [("office", 16, OUTLINES, 4), pytest.param("intel", 5, {}, 3, marks=pytest.mark.long)],
)
def test_all_robots_are_shown_in_the_dark_and_no_view_reports_an_error(
    name: str,
    robots: int,
    more: dict[str, str],
    kinds: int,
    tmp_path: Path,
    request: pytest.FixtureRequest,
) -> None:
    where = name if name == "office" else str(request.getfixturevalue("real_maps") / "intel.yaml")
    recording = recorded(tmp_path, map=where, robots=robots, range="30%", steps=65, **more)
    with viewer(recording) as client:
        png = settled_picture(client, 60)
        state = client.get_state()
        logs = client.get_logs()
    keep(f"dashboard-{name}", png)
    assert {view.name: view.reports for view in state.views if view.reports} == {}
    assert {view.name for view in state.views} >= {
        *VIEWS,
        *(f"Robot {robot} [m]" for robot in range(min(8, robots))),
    }
    assert [entry.message for entry in logs if entry.level == "ERROR"] == []
    assert Image.open(io.BytesIO(png)).size == (1920, 1080)
    assert_shows_robots(png, robots)
    assert_is_to_be_read(png, light=False, kinds=kinds)


SIZES = [(1280, 720), (1366, 768), (1920, 1080)]


@pytest.fixture(scope="module")
def small_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("small"), robots=8, range="30%", steps=25, **OUTLINES)


@pytest.mark.long
@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_the_page_shows_the_dashboard_in_a_real_browser(
    theme: str, size: tuple[int, int], small_recording: Path
) -> None:
    printed: list[str] = []
    window = Window("web", printed.append)
    with Browser(*size) as browser:
        window.open(small_recording)
        try:
            assert printed == [f"Dashboard: {window.address}"]
            assert window.address.startswith("http://127.0.0.1:")
            browser.open(f"{window.address}&persist=0&renderer=webgl&theme={theme}")
            png = browser.settled_picture(120.0, least=60_000)
        finally:
            window.close()
    keep(f"dashboard-{theme}-{size[0]}", png)
    assert_shows_robots(png, 8)
    assert_is_to_be_read(png, light=theme == "light", kinds=3, top=0)


@pytest.mark.long
def test_a_thousand_steps_of_eight_robots_are_less_than_thirty_megabytes(
    tmp_path: Path, real_maps: Path
) -> None:
    where = str(real_maps / "intel.yaml")
    slow = {"speed": 0.1, "sensor_range": 2.0}
    recording = recorded(tmp_path, map=where, robots=8, range="30%", steps=1000, **slow)
    assert json.loads((recording.parent / SUMMARY).read_text())["steps"] == 1000
    assert recording.stat().st_size < 30e6
