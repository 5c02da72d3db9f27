"""Decoding all logs again after forged or damaged entries were dropped."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace

from agent.encodings.base import MapEncoding
from agent.encodings.catalog import make_encoding
from agent.encodings.predictive import RETURN_STEPS
from deploy.scenario.plan import Plan
from protocol.errors import ProtocolError
from protocol.grid import UNKNOWN, Grid, ray_table
from protocol.packet_codec import decode
from protocol.packets import Update
from protocol.scans import Scan, draw
from tests.system.team import corridor, plan_on
from worldsim.laser import cast

WIDTH, HEIGHT, STEPS, ROBOTS = 120, 9, 16, 3
ENCODINGS = ["polygons", "scans", "cells", "predictive", "zstd-maps"]


@cache
def plan(encoding: str) -> Plan:
    return plan_on(
        corridor(WIDTH - 2, HEIGHT - 4),
        robots=ROBOTS,
        sensor_range=1.0,
        map_encoding=encoding,
        bandwidth="unlimited",
    )


class Writer:
    """A robot that drives along the corridor and encodes what it sees, from some step on false walls."""

    def __init__(self, name: str, robot: int, *, forges_from: int = STEPS) -> None:
        self.encoding: MapEncoding = make(name, robot)
        self.own: Grid = np.full((HEIGHT, WIDTH), UNKNOWN, np.uint8)
        self._name, self._robot, self._forges_from = name, robot, forges_from

    def drive(self, step: int) -> list[bytes]:
        truth, x = plan(self._name).map.cells, 4 + 35 * self._robot + step
        rays = ray_table(plan(self._name).world.bodies[0].range_cells)
        readings = cast(truth, np.zeros(truth.shape, np.bool_), rays, x, 4)
        if step >= self._forges_from:
            readings = np.minimum(readings, 3)
        scan = Scan(x, 4, readings)
        change = draw(self.own, rays, x, 4, scan.readings)
        return self.encoding.encode_changes(self.own, scan, change, delivered=True)


def make(name: str, robot: int) -> MapEncoding:
    return make_encoding(plan(name).robot_settings[robot])


def merged(encoding: MapEncoding) -> Grid:
    return encoding.merge(np.full((HEIGHT, WIDTH), UNKNOWN, np.uint8), range(ROBOTS)).copy()


def apply(encoding: MapEncoding, map_id: int, entries: list[bytes], step: int) -> None:
    if entries:
        encoding.apply(map_id, b"".join(entries), step=step, sender=map_id)


@pytest.mark.parametrize("name", ENCODINGS)
def test_after_rebuilding_a_robot_holds_what_one_holds_that_received_the_true_entries_alone(
    name: str,
) -> None:
    writers = [Writer(name, 1), Writer(name, 2), Writer(name, 1, forges_from=STEPS // 2)]
    true: list[list[bytes]] = [[], [], []]
    deceived, fresh = make(name, 0), make(name, 0)
    for step in range(1, STEPS):
        first, second, forged = (writer.drive(step) for writer in writers)
        true[1] += first
        true[2] += second
        apply(deceived, 1, forged, step)
        apply(deceived, 2, second, step)
        apply(fresh, 1, first, step)
        apply(fresh, 2, second, step)
    wrong, meant = merged(deceived), merged(fresh)
    assert (wrong != meant).any()
    assert (merged(deceived) == wrong).all()
    deceived.rebuild([b"".join(log) for log in true], STEPS)
    assert (merged(deceived) == meant).all()
    deceived.rebuild([b"", b"", b"".join(true[2])], STEPS)
    assert (merged(deceived)[:, : 4 + 2 * 35 - 25] == UNKNOWN).all(), "nothing of map 1 is left"
    apply(deceived, 1, true[1], STEPS)
    assert (merged(deceived) == meant).all(), "the true entries came again"


@pytest.mark.parametrize("name", ENCODINGS)
def test_a_fragment_in_front_of_dropped_entries_does_not_spoil_the_next_ones(name: str) -> None:
    writer, deceived, fresh = Writer(name, 1), make(name, 0), make(name, 0)
    true = [entry for step in range(1, STEPS) for entry in writer.drive(step)]
    for at, each in enumerate(true):
        apply(fresh, 1, [each], at)
        if at < 3:
            apply(deceived, 1, [each], at)
    for kept in (2, 1, 0):
        deceived.rebuild([b"", b"".join(true[:kept]), b""], STEPS)
    apply(deceived, 1, true, STEPS)
    assert (merged(deceived) == merged(fresh)).all()


def test_own_updates_that_depended_on_dropped_ones_are_withdrawn_for_all_robots() -> None:
    def look(encoding: MapEncoding, own: Grid, x: int) -> list[bytes]:
        truth, rays = plan("predictive").map.cells, ray_table(plan("predictive").world.bodies[0].range_cells)
        scan = Scan(x, 4, cast(truth, np.zeros(truth.shape, np.bool_), rays, x, 4))
        change = draw(own, rays, x, 4, scan.readings)
        return encoding.encode_changes(own, scan, change, delivered=True)

    author, forger = Writer("predictive", 1), Writer("predictive", 1, forges_from=1)
    deceived, third = make("predictive", 0), make("predictive", 2)
    settings = plan("predictive").robot_settings[2]
    patient = make_encoding(replace(settings, replication=replace(settings.replication, digests=True)))
    own: Grid = np.full((HEIGHT, WIDTH), UNKNOWN, np.uint8)
    true: list[bytes] = []
    log: list[bytes] = []
    for step in range(1, STEPS):
        true += author.drive(step)
        apply(deceived, 1, forger.drive(step), step)
        log += look(deceived, own, 44 + step)
    assert any(each.requires for each in deceived.dependencies(0))
    written = len(log)
    deceived.rebuild([b"".join(log), b"".join(true), b""], STEPS)
    for step in range(STEPS, STEPS + 2 * RETURN_STEPS):
        log += look(deceived, own, 44 + step)
    numbers = [each for each in decode(b"".join(log[written:])) if isinstance(each, Update) and not each.data]
    assert numbers, "empty updates withdraw the others"
    apply(third, 1, true, 60)
    apply(third, 0, log, 60)
    apply(patient, 1, true, 60)
    refused = []
    for entry in log:
        try:
            apply(patient, 0, [entry], 60)
        except ProtocolError:
            refused.append(entry)
            apply(patient, 0, [entry], 61)
    assert len(refused) == 1, "an entry that arrives again is what its author wrote"
    meant = np.where(own == UNKNOWN, author.own, own)
    nothing = np.full((HEIGHT, WIDTH), UNKNOWN, np.uint8)
    assert (third.merge(nothing, range(ROBOTS)) == meant).all()
    assert (deceived.merge(own, range(ROBOTS)) == meant).all()
    assert (patient.merge(nothing, range(ROBOTS)) == meant).all(), "its withdrawal arrived later"
