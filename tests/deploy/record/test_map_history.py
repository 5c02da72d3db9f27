"""The robots' maps over time: complete, readable back, and protected against malformed reports."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from agent.outline.polygons import Polygons
from agent.viewer_feed import outline_bytes
from deploy.record.map_history import MapHistory
from deploy.run.exploration import explore
from deploy.scenario.scenario import parse
from protocol.errors import ProtocolError
from protocol.messages import MapChanges, Outlines
from tests.agent.outline.edit_scripts import packed
from tests.deploy.small_run import small_directory, small_plan, small_run


def changes(step: int, *cells: tuple[int, int]) -> MapChanges:
    places = np.array([cell for cell, _ in cells], "<u4").tobytes()
    return MapChanges(step, places, bytes(value for _, value in cells))


def test_the_last_maps_are_those_that_the_robots_handed_in() -> None:
    records = small_run().records
    for robot in range(3):
        np.testing.assert_array_equal(records.maps.own(robot, 40), records.own[robot])
        np.testing.assert_array_equal(records.maps.planning(robot, 40), records.planning[robot])


def test_a_history_is_read_back_as_it_was_written() -> None:
    written = small_run().records.maps
    read = MapHistory.read(small_directory(), small_plan().map.cells.shape)
    for robot in range(3):
        assert read.steps(robot) == written.steps(robot)
        for step in (40, 5, 23, 24):
            np.testing.assert_array_equal(read.planning(robot, step), written.planning(robot, step))
            np.testing.assert_array_equal(read.own(robot, step), written.own(robot, step))
        for map_id in written.maps_held(robot):
            assert read.outlines(robot, map_id, 30) == written.outlines(robot, map_id, 30)
    assert read.planning(0, 4) is None
    assert read.outlines(0, 0, 4) == b""


def polygons_of(vertices: bytes, shape: tuple[int, int]) -> Polygons:
    """Decode polygons that `outline_bytes` encoded, on a grid of `shape` (h, w)."""
    rows = np.frombuffer(vertices, "<i2").reshape(-1, 4)
    x, y = (rows[:, 1] + 1) // 4, (rows[:, 2] + 1) // 4
    across, down = rows[:, 1] - 4 * x, rows[:, 2] - 4 * y
    side = np.where(across == 0, 1 - down, 2 - across)
    start = np.append(np.flatnonzero(np.diff(rows[:, 0], prepend=-1)), len(rows)).astype(np.int32)
    flags = rows[:, 3].astype(np.uint8)
    drawn = np.column_stack([x, y, side, flags & 1]).tolist()
    return Polygons(shape, packed(drawn), start, flags[start[:-1]] >> 1 == 1)


def test_outlines_are_decoded_to_the_polygons_that_were_encoded() -> None:
    vertices = small_run().records.maps.outlines(0, 0, 40)
    assert outline_bytes(polygons_of(vertices, small_plan().map.cells.shape)) == vertices
    assert polygons_of(b"", (3, 3)).objects == 0


@pytest.mark.parametrize("bus", ["memory", "zenoh"])
def test_a_robot_that_starts_again_reports_its_whole_map(bus: str, tmp_path: Path) -> None:
    settings = {
        "map": "office", "robots": 2, "bandwidth": 300, "steps": 40, "bus": bus, "map_encoding": "polygons",
        "fault": [{"step": 12, "robot": 1, "kind": "kill"}, {"step": 18, "robot": 1, "kind": "restart"}],
    }  # fmt: skip
    records = explore(parse(settings), out=tmp_path / "run").records
    for robot in range(2):
        np.testing.assert_array_equal(records.maps.own(robot, 40), records.own[robot])
        np.testing.assert_array_equal(records.maps.planning(robot, 40), records.planning[robot])


def test_runs_that_are_not_kept_record_no_maps() -> None:
    records = explore(map="em", robots=2, bus="memory", steps=12, keep=False).records
    assert records.maps.steps(0) == []


@pytest.mark.parametrize(
    ("report", "message"),
    [
        (changes(5, (12, 1)), "a cell outside the map"),
        (changes(5, (0, 3)), "not free, occupied or unknown"),
        (changes(5, (0, 12)), "not free, occupied or unknown"),
        (changes(4, (0, 1)), "step 4 after step 5"),
        (Outlines(4, 0, b""), "step 4 after step 5"),
    ],
)
def test_malformed_reports_are_refused(report: MapChanges | Outlines, message: str) -> None:
    history = MapHistory((3, 4))
    history.take(0, changes(5, (11, 10)))
    history.take(0, Outlines(5, 0, b""))
    with pytest.raises(ProtocolError, match=message):
        history.take(0, report)
    history.take(0, changes(5, (0, 1)))
    with pytest.raises(ProtocolError, match="step 5 after step 5"):
        history.take(0, changes(5, (0, 1)))
    assert history.steps(0) == [5, 5]
