"""The dashboard's layout: titles fit beside the buttons of their panels, and colors tell robots from traffic."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from PIL import ImageFont

from deploy.record.colors import GROUPS, IN_RANGE, ROBOTS, SIGNAL
from deploy.scenario.plan import make
from deploy.scenario.scenario import parse

rrb = pytest.importorskip(
    "rerun.blueprint", reason="Rerun is not installed: pip install 'murmur-robots[view]'"
)

ICON, BUTTONS, BORDER = 30, 85, 10
"""Pixels of the icon before each title, of a panel's buttons, and between panels, as Rerun 0.41 draws them."""
WIDER = 0.95
"""Width of Rerun's font / width of DejaVu Sans."""


def width_of(text: str) -> float:
    font = ImageFont.truetype(str(Path(matplotlib.get_data_path(), "fonts", "ttf", "DejaVuSans.ttf")), 12)
    return WIDER * font.getlength(text) + ICON


def panels(part: Any, wide: float) -> list[tuple[list[str], float]]:
    """The titles of each title bar, and its width in pixels."""
    if isinstance(part, rrb.Tabs):
        own = [([str(each.name) for each in part.contents], wide)]
        inner = [each for each in part.contents if not isinstance(each, rrb.View)]
        return own + [found for each in inner for found in panels(each, wide)]
    if isinstance(part, rrb.Horizontal):
        shares = part.column_shares
        return [
            found
            for each, share in zip(part.contents, shares, strict=True)
            for found in panels(each, wide * share / sum(shares))
        ]
    if isinstance(part, rrb.Grid):
        return [found for each in part.contents for found in panels(each, wide / part.grid_columns)]
    if isinstance(part, rrb.Vertical):
        return [found for each in part.contents for found in panels(each, wide)]
    return [([str(part.name)], wide)]


@pytest.mark.parametrize("width", [1280, 1366, 1920])
@pytest.mark.parametrize(
    "settings",
    [{"robots": 1}, {"robots": 8}, {"robots": 30}, {"robots": 64}, {"robots": 3, "clock": "wall"}],
    ids=str,
)
def test_every_title_fits_into_its_panel(settings: dict[str, Any], width: int) -> None:
    from deploy.dashboard.layout import layout

    found = panels(layout(make(parse(settings))).root_container, width)
    assert len(found) > 6
    for titles, wide in found:
        needed = sum(map(width_of, titles)) + BUTTONS + BORDER
        assert needed <= wide, f"{titles}: {needed:.0f} px in {wide:.0f} px"


def test_every_axis_has_a_unit() -> None:
    from deploy.dashboard.layout import layout

    titles = {title for shown, _ in panels(layout(make(parse({"robots": 2, "clock": "wall"}))).root_container, 1280)
              for title in shown}  # fmt: skip
    without = {title for title in titles if not title.endswith("]")}
    assert without == {"Maps 0-1", "True map 0-1", "Help", "Events"}


def lab(color: Any) -> Any:
    """CIELAB coordinates of an sRGB color (CIE 15:2004)."""
    shares = np.array(color) / 255
    linear = np.where(shares <= 0.04045, shares / 12.92, ((shares + 0.055) / 1.055) ** 2.4)
    matrix = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    x, y, z = np.cbrt(np.array(matrix) @ linear / (0.9505, 1.0, 1.089))
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def distance(one: Any, other: Any) -> float:
    return float(np.linalg.norm(lab(one) - lab(other)))


def test_no_color_of_traffic_can_be_taken_for_a_robot() -> None:
    """A color difference (CIE76) of 20 is obvious at a glance."""
    traffic = {group.color for group in GROUPS.values()} | {SIGNAL, IN_RANGE}
    closest = min((distance(one, robot), one, robot) for one in traffic for robot in ROBOTS)
    assert closest[0] > 20, closest
    maps = {GROUPS[name].color for name in ("vertices", "scans", "updates")}
    others = [group.color for group in GROUPS.values() if group.color not in maps]
    assert min(distance(*pair) for pair in combinations([*others, maps.pop()], 2)) > 20
