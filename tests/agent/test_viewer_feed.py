"""The feed to a viewer: whole maps first, then changed maps alone."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from agent.outline.contour import contours
from agent.outline.polygons import Polygons
from agent.viewer_feed import ViewerFeed, outline_bytes
from protocol.cell_bytes import grid_from_bytes
from protocol.messages import Outlines, Snapshot


def robot(planning: Any, polygons: dict[int, Polygons]) -> Any:
    return SimpleNamespace(planning=planning, polygons=polygons)


def room(width: int = 7) -> Any:
    grid = np.zeros((5, width), np.uint8)
    grid[1:4, 1 : width - 1] = 1
    grid[0] = 2
    return grid


def test_the_first_feed_has_all_maps_and_later_feeds_only_changed_maps() -> None:
    feed = ViewerFeed()
    grid = room()
    mine, other = contours(grid, (2, 2)), contours(room(9), (2, 2))
    first = feed.news(5, robot(grid, {0: mine, 2: other}))
    assert [type(message) for message in first] == [Snapshot, Outlines, Outlines]
    assert feed.news(10, robot(grid.copy(), {0: mine, 2: other})) == []
    grid = grid.copy()
    grid[2, 2] = 0
    (message,) = feed.news(15, robot(grid, {0: mine, 2: other}))
    assert isinstance(message, Snapshot)
    assert message.step == 15
    assert (grid_from_bytes(message.planning, message.width, message.height) == grid).all()
    (message,) = feed.news(20, robot(grid, {0: mine, 2: mine}))
    assert isinstance(message, Outlines)
    assert message.map_id == 2


def test_outlines_contain_position_object_and_kind_of_every_vertex() -> None:
    polygons = contours(room(), (2, 2))
    rows = np.frombuffer(outline_bytes(polygons), "<i2").reshape(-1, 4)
    assert len(rows) == len(polygons.x)
    assert (rows[:, 0] == 0).all()
    above = (polygons.y == 0).nonzero()[0]
    assert (rows[above, 2] == 1).all()  # a quarter of a cell below the centre of row 0, towards the free cell
    assert ((rows[:, 3] & 1) == polygons.occupied).all()
    assert (rows[:, 3] >> 1 == 1).all()
    assert outline_bytes(Polygons.empty((5, 7))) == b""
