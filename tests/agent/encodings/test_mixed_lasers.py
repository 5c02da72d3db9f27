"""Encodings of scans: receivers read each author's scans with that author's laser, whatever their own is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.encodings.catalog import make_encoding
from agent.mapping.estimator import Estimator
from agent.settings import EncodingSettings, ReplicationSettings, Settings
from protocol.body import Body
from protocol.grid import Grid
from protocol.range_scans import TURN, UNIT, Laser, RangeScan, beam_ends, smoothed
from tests.agent.encodings.arrival import LATE

CELL, SIDE = 0.1, 60

lasers = st.builds(
    Laser,
    beams=st.integers(2, 80),
    first=st.integers(-TURN // 2, 0),
    span=st.integers(TURN // 8, TURN - 1),
    reach_mm=st.integers(500, 4000),
)


def settings_of(robot: int, name: str, team: list[Laser]) -> Settings:
    bodies = tuple(Body(laser.reach_mm / 1000 / CELL, 360.0, 5.0, laser=laser) for laser in team)
    return Settings(
        robot=robot, bodies=bodies, width=SIDE, height=SIDE, beams=36, seed=0, strategy="meier",
        encoding=EncodingSettings(name), replication=ReplicationSettings("gossip"), resolution=CELL,
    )  # fmt: skip


@pytest.mark.parametrize("name", ["scans", "slam-toolbox"])
@given(team=st.lists(lasers, min_size=3, max_size=3), seed=st.integers(0, 999))
def test_receivers_estimate_each_map_with_the_laser_of_its_author(
    name: str, team: list[Laser], seed: int
) -> None:
    rng, empty = np.random.default_rng(seed), np.zeros((SIDE, SIDE), np.uint8)
    maps: list[Grid] = []
    together = make_encoding(settings_of(2, name, team))
    for author in (0, 1):
        laser, sender = team[author], make_encoding(settings_of(author, name, team))
        receiver, wanted = make_encoding(settings_of(2, name, team)), Estimator(SIDE, SIDE)
        for number in range(3):
            ranges = rng.integers(1, 4500, laser.beams).astype(np.uint16)
            place = (20 + 7 * number) * UNIT, (25 + author) * UNIT
            scan = RangeScan(place, int(rng.integers(TURN)), ranges)
            change = wanted.add(*scan.place, *beam_ends(smoothed(scan, laser), laser, CELL))
            for packet in sender.encode_changes(wanted.states, scan, change, delivered=True):
                receiver.apply(author, packet, **LATE)
                together.apply(author, packet, **LATE)
        assert np.array_equal(receiver.merge(empty), wanted.states)
        maps.append(wanted.states)
    assert np.array_equal(together.merge(empty) != 0, (maps[0] != 0) | (maps[1] != 0))
