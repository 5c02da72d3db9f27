"""The mapper of a noisy laser: what a robot bumps into, and what only passes by."""

from __future__ import annotations

import numpy as np
import pytest

from agent.mapping.estimator import NEAR_LOOKS
from agent.mapping.mapper import make_mapper
from agent.settings import EncodingSettings, ReplicationSettings, Settings
from protocol.body import Body
from protocol.grid import FREE, OCCUPIED, UNKNOWN
from protocol.messages import Sense
from protocol.range_scans import NO_MEASUREMENT, NOTHING, TURN, UNIT, Laser, RangeScan, encode_range_scan

LASER = Laser(36, 0, TURN - TURN // 36, 2000)


def settings_of(laser: Laser) -> Settings:
    return Settings(
        robot=0, bodies=(Body(20.0, 360.0, 5.0, laser=laser),), width=30, height=30, beams=36, seed=0, strategy="meier",
        encoding=EncodingSettings("none"), replication=ReplicationSettings("gossip"),
    )  # fmt: skip


def sense(step: int, blocked: str = "", range_mm: int = NO_MEASUREMENT, beams: int = LASER.beams) -> Sense:
    """The readings of a robot in cell (10, 10) that heads along +x."""
    place = 10 * UNIT + UNIT // 2
    ranges = np.full(beams, range_mm, np.uint16)
    scan = encode_range_scan(RangeScan((place, place), 0, ranges))
    return Sense(step, 10, 10, 0, b"", b"", blocked, 0, 0, scan)


@pytest.mark.parametrize(("blocked", "ahead"), [("wall", OCCUPIED), ("person", UNKNOWN), ("robot", UNKNOWN)])
def test_only_a_bump_into_a_wall_marks_the_cell_ahead(blocked: str, ahead: int) -> None:
    mapper = make_mapper(settings_of(LASER))
    mapper.add(sense(1, blocked))
    assert mapper.states[10, 11] == ahead
    assert mapper.states[10, 10] == FREE
    for step in range(2, 6):
        mapper.add(sense(step, range_mm=1000))
    assert mapper.states[10, 11] == FREE, "the mark of a bump fades when the cell is seen empty"


@pytest.mark.parametrize("reach_mm", [100, 300, 800, 1400, 2000])
def test_cells_beyond_the_range_of_a_laser_do_not_become_walls(reach_mm: int) -> None:
    # A robot that stands in the open, and measures nothing within the range.
    laser = Laser(360, 0, TURN - TURN // 360, reach_mm)
    mapper = make_mapper(settings_of(laser))
    for step in range(1, 3 * NEAR_LOOKS):
        mapper.add(sense(step, range_mm=NOTHING, beams=laser.beams))
    assert (mapper.states == FREE).any()
    assert not (mapper.states == OCCUPIED).any()
