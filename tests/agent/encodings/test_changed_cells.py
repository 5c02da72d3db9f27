"""Planning grids and errors brought up to date where something has changed are those made anew."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.encodings.base import MapEncoding
from agent.encodings.catalog import make_encoding
from agent.encodings.received_grid import ChangedCells
from agent.settings import EncodingSettings, MediumSettings, ReplicationSettings, Settings
from protocol.body import Body
from protocol.budget import UNLIMITED, Budget
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid, ray_table
from protocol.scans import GridChange, Scan, draw
from tests.agent.encodings.arrival import LATE
from tests.agent.explorations import Cell
from worldsim.laser import cast

BEAMS, RANGE, ROBOTS = 120, 14.0, 3


def house() -> Grid:
    grid = np.full((48, 70), FREE, np.uint8)
    grid[0] = grid[-1] = grid[:, 0] = grid[:, -1] = OCCUPIED
    grid[22, :50] = grid[1:22, 33] = OCCUPIED
    grid[8:11, 33] = grid[22, 12:15] = FREE
    rng = np.random.default_rng(5)
    for y, x in rng.integers((2, 2), (45, 67), (20, 2)).tolist():
        grid[y : y + 2, x] = OCCUPIED
    return grid


def settings_of(kind: str, robot: int, bandwidth: Budget) -> Settings:
    world = house()
    return Settings(
        robot=robot, bodies=(Body(RANGE, 360.0, 3.0),) * ROBOTS, width=world.shape[1], height=world.shape[0],
        beams=BEAMS, seed=0, strategy="meier", encoding=EncodingSettings(kind),
        replication=ReplicationSettings("backoff"), medium=MediumSettings(bandwidth),
    )  # fmt: skip


def next_cell(world: Grid, cell: Cell, rng: np.random.Generator) -> Cell:
    """A free cell near by in a straight line, so that the cells between are free as well."""
    for _ in range(100):
        dx, dy = ((1, 0), (-1, 0), (0, 1), (0, -1))[rng.integers(4)]
        way = [(cell[0] + i * dx, cell[1] + i * dy) for i in range(1, 5)]
        if all(world[y, x] == FREE for x, y in way):
            return way[-1]
    return cell


class Looker:
    """A robot that drives about, sees, and keeps one grid for good; and a encoding that sees copies of it."""

    def __init__(self, kind: str, robot: int, bandwidth: Budget) -> None:
        self.robot = robot
        self.own = np.full(house().shape, UNKNOWN, np.uint8)
        self.encoding: MapEncoding = make_encoding(settings_of(kind, robot, bandwidth))
        self.forgetful: MapEncoding = make_encoding(settings_of(kind, robot, bandwidth))
        self.cell: Cell = (5 + 20 * robot, 30)

    def scan(self, rng: np.random.Generator) -> list[bytes]:
        world = house()
        before, self.cell = self.cell, next_cell(world, self.cell, rng)
        xs, ys = (sorted((one, other)) for one, other in zip(before, self.cell, strict=True))
        between = [(x, y) for x in range(xs[0], xs[1] + 1) for y in range(ys[0], ys[1] + 1)]
        laser = ray_table(RANGE, BEAMS)
        readings = cast(world, np.zeros(world.shape, np.bool_), laser, *self.cell)
        change = draw(self.own, laser, *self.cell, readings, np.array(between, np.int32))
        scan = Scan(*self.cell, readings)
        delivered = bool(rng.random() < 0.6)
        packets = self.encoding.encode_changes(self.own, scan, change, delivered=delivered)
        assert self.forgetful.encode_changes(self.own.copy(), scan, change, delivered=delivered) == packets
        return packets

    def check(self, peers: tuple[int, ...]) -> None:
        plan = self.encoding.merge(self.own, peers)
        assert plan.tolist() == self.forgetful.merge(self.own.copy(), peers).tolist()
        assert self.encoding.approximation_error(self.own) == self.forgetful.approximation_error(
            self.own.copy()
        )


@pytest.mark.parametrize("kind", ["polygons", "scans", "none"])
@pytest.mark.parametrize("bandwidth", [Budget(60), UNLIMITED])
def test_incremental_results_equal_those_computed_from_scratch(kind: str, bandwidth: Budget) -> None:
    rng = np.random.default_rng(1)
    team = [Looker(kind, robot, bandwidth) for robot in range(ROBOTS)]
    for _ in range(40):
        reported = [robot.scan(rng) for robot in team]
        for receiver in team:
            for sender, packets in zip(team, reported, strict=True):
                if sender is not receiver and packets:
                    for encoding in (receiver.encoding, receiver.forgetful):
                        encoding.apply(sender.robot, b"".join(packets), **LATE)
            peers = tuple(other for other in range(ROBOTS) if rng.random() < 0.7)
            receiver.check(tuple(peer for peer in peers if peer != receiver.robot))


def boxes_of(news: ChangedCells, grid: NDArray[Any]) -> list[list[int]] | None:
    found = news.take(grid)
    return None if found is None else found.tolist()


def test_for_another_grid_all_cells_count_as_changed() -> None:
    one, other, news = np.zeros((9, 9), np.uint8), np.zeros((9, 9), np.uint8), ChangedCells()
    assert boxes_of(news, one) is None
    assert boxes_of(news, one) == []
    news.add(one, GridChange(3, (1, 2, 4, 5)))
    news.add(other, GridChange(1, (7, 7, 8, 8)))
    assert boxes_of(news, one) == [[1, 2, 4, 5]]
    assert boxes_of(news, other) is None
    assert boxes_of(news, one) is None
