"""Streams: whatever a self-explored grid becomes, who follows the stream knows it, and nonsense changes nothing."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.predictive import contexts
from agent.predictive.history import DecodedUpdate, History
from agent.predictive.scan_updates import MAX_LOOKS, STATE, TOLD
from agent.predictive.stream import Stream
from protocol.errors import ProtocolError
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid, ray_table
from protocol.scans import draw
from tests.agent.predictive.plain_predictive import PlainStream
from worldsim import generators
from worldsim.laser import cast

BEAMS = 36
RANGES = (5.0, 3.0, 7.0)
seeds = st.integers(0, 2**32 - 1)

Cell = tuple[int, int]


class Group:
    """All streams, as one robot holds them."""

    def __init__(
        self, shape: tuple[int, int], *, team: bool = True, ranges: tuple[float, ...] = RANGES
    ) -> None:
        self.grids = np.zeros((len(ranges), *shape), np.uint8)
        self.histories = [History() for _ in ranges]
        scratch = np.empty((2 * shape[0] * shape[1], 2), np.int32)
        self.streams = [
            Stream(robot, self.grids[robot], ray_table(reach, BEAMS), self.histories, scratch, team=team)
            for robot, reach in enumerate(ranges)
        ]

    def follows(self, robot: int, own: Grid) -> bool:
        """Whether a self-explored grid follows from the robot's stream."""
        grid = self.grids[robot]
        known = own != UNKNOWN
        return bool(((grid & STATE) == own)[known].all() and not (grid[~known] & TOLD).any())


@dataclass
class Scene:
    """Robots whose grids change in any way, and where they say they looked from."""

    rng: np.random.Generator
    own: list[Grid]

    @classmethod
    def drawn(cls, seed: int) -> Scene:
        rng = np.random.default_rng(seed)
        shape = int(rng.integers(1, 16)), int(rng.integers(1, 16))
        return cls(rng, [np.zeros(shape, np.uint8) for _ in RANGES])

    @property
    def shape(self) -> tuple[int, int]:
        height, width = self.own[0].shape
        return height, width

    def change(self, robot: int) -> list[Cell]:
        """See something, forget something, change one's mind; return where from."""
        rng, own = self.rng, self.own[robot]
        height, width = own.shape
        truth = np.random.default_rng(3).choice((FREE, FREE, OCCUPIED), own.shape).astype(np.uint8)
        poses = [(int(rng.integers(width)), int(rng.integers(height))) for _ in range(rng.integers(0, 4))]
        nobody = np.zeros(own.shape, np.bool_)
        beams = ray_table(RANGES[robot], BEAMS)
        for x, y in poses:
            if rng.random() < 0.8:
                draw(own, beams, x, y, cast(truth, nobody, beams, x, y))
        for _ in range(rng.choice((0, 0, 1, 5, 40))):
            own[rng.integers(height), rng.integers(width)] = rng.integers(3)
        return poses

    def tell(self, group: Group, robot: int) -> tuple[bytes, DecodedUpdate] | None:
        height, width = self.shape
        unit = group.streams[robot].encode(self.own[robot], self.change(robot), (0, 0, width, height))
        return None if unit is None else unit[:2]


@given(seeds, st.booleans())
def test_any_change_of_a_grid_is_told_without_loss(seed: int, team: bool) -> None:
    scene = Scene.drawn(seed)
    maker, hearer = Group(scene.shape, team=team), Group(scene.shape, team=team)
    for _ in range(12):
        robot = int(scene.rng.integers(len(RANGES)))
        unit = scene.tell(maker, robot)
        if unit is None:
            continue
        message, told = unit
        heard = hearer.streams[robot].decode(message)
        assert heard is not None
        assert heard.places.tolist() == told.places.tolist()
        assert heard.states.tolist() == told.states.tolist()
        assert hearer.follows(robot, scene.own[robot])
        assert (hearer.grids == maker.grids).all()


@given(seeds)
def test_with_base_own_a_stream_alone_tells_the_whole_grid(seed: int) -> None:
    scene = Scene.drawn(seed)
    maker, hearer = Group(scene.shape, team=False), Group(scene.shape, team=False)
    for _ in range(6):
        if (unit := scene.tell(maker, 0)) is not None:
            hearer.streams[0].decode(unit[0])
        assert (hearer.grids[0] & STATE).tolist() == scene.own[0].tolist()


@given(seeds)
def test_a_unit_waits_for_what_it_is_built_on_and_nothing_changes_until_then(seed: int) -> None:
    scene = Scene.drawn(seed)
    maker, hearer = Group(scene.shape), Group(scene.shape)
    said: list[list[bytes]] = [[] for _ in RANGES]
    for _ in range(15):
        robot = int(scene.rng.integers(len(RANGES)))
        if (unit := scene.tell(maker, robot)) is not None:
            said[robot].append(unit[0])
    while any(said):
        waits = True
        for robot in scene.rng.permutation(len(RANGES)).tolist():
            before = hearer.grids.copy()
            if said[robot]:
                if hearer.streams[robot].decode(said[robot][0]) is None:
                    assert (hearer.grids == before).all()
                else:
                    del said[robot][0]
                    waits = False
        assert not waits, "units wait for each other"
    assert (hearer.grids == maker.grids).all()


@given(seeds)
def test_a_unit_that_is_taken_back_leaves_no_trace(seed: int) -> None:
    scene = Scene.drawn(seed)
    maker, other = Group(scene.shape), Group(scene.shape)
    for _ in range(8):
        robot = int(scene.rng.integers(len(RANGES)))
        height, width = scene.shape
        whole = 0, 0, width, height
        poses = scene.change(robot)
        if maker.streams[robot].encode(scene.own[robot], poses, whole) is not None:
            maker.streams[robot].undo()
            maker.histories[robot].pop()
        poses += scene.change(robot)
        once, again = (
            group.streams[robot].encode(scene.own[robot], poses, whole) for group in (maker, other)
        )
        assert (once is None) == (again is None)
        if once is not None and again is not None:
            assert once[0] == again[0]
        assert (maker.grids == other.grids).all()


@given(seeds)
def test_a_unit_is_the_plain_writer_s_to_the_byte(seed: int) -> None:
    scene = Scene.drawn(seed)
    maker = Group(scene.shape, team=False)
    plain = PlainStream(scene.shape, ray_table(RANGES[0], BEAMS))
    height, width = scene.shape
    for _ in range(5):
        poses = scene.change(0)
        unit = maker.streams[0].encode(scene.own[0], poses, (0, 0, width, height))
        if unit is not None:
            assert unit[0] == plain.unit(scene.own[0], poses)[0]
            assert (maker.grids[0] & STATE).tolist() == plain.known.tolist()


def exploration(steps: int = 25) -> tuple[Grid, list[tuple[Grid, Cell]]]:
    """A walk through a generated office: after each step what is known, and where the robot is."""
    truth = generators.make("office", width_m=12, height_m=12).cells
    nobody, beams = np.zeros(truth.shape, np.bool_), ray_table(30.0, BEAMS)
    own = np.zeros(truth.shape, np.uint8)
    cell = np.argwhere(truth == FREE)[900].tolist()
    walk = []
    rng = np.random.default_rng(0)
    for _ in range(steps):
        ahead = [
            (y, x)
            for y, x in (
                (cell[0] + 4, cell[1]),
                (cell[0] - 4, cell[1]),
                (cell[0], cell[1] + 4),
                (cell[0], cell[1] - 4),
            )
            if 0 <= y < truth.shape[0] and 0 <= x < truth.shape[1] and truth[y, x] == FREE
        ]
        cell = ahead[rng.integers(len(ahead))]
        draw(own, beams, cell[1], cell[0], cast(truth, nobody, beams, cell[1], cell[0]))
        walk.append((own.copy(), (cell[1], cell[0])))
    return truth, walk


def test_the_units_of_a_walk_are_within_3_percent_of_their_ideal_length_and_half_a_byte_each() -> None:
    truth, walk = exploration()
    stream = Group((truth.shape[0], truth.shape[1]), team=False, ranges=(30.0,)).streams[0]
    plain = PlainStream((truth.shape[0], truth.shape[1]), ray_table(30.0, BEAMS))
    height, width = truth.shape
    sizes, ideal = 0, 0.0
    count = 0
    for own, pose in walk:
        unit = stream.encode(own, [pose], (0, 0, width, height))
        if unit is not None:
            message, bits = plain.unit(own, [pose])
            assert unit[0] == message
            sizes, ideal, count = sizes + len(message), ideal + bits / 8, count + 1
    assert count > 10
    assert sizes <= 1.03 * ideal + 0.6 * count


def test_a_scan_of_an_office_takes_a_hundredth_of_its_readings() -> None:
    truth, walk = exploration()
    stream = Group((truth.shape[0], truth.shape[1]), team=False, ranges=(30.0,)).streams[0]
    height, width = truth.shape
    units = [stream.encode(own, [pose], (0, 0, width, height)) for own, pose in walk]
    told = sum(len(unit[0]) for unit in units if unit is not None)
    assert told < len(walk) * 2 * (BEAMS + 2) / 4


messages = st.binary(max_size=64)


@given(seeds, messages, st.lists(st.tuples(st.integers(0, 63), st.integers(0, 255)), max_size=3))
def test_noise_and_garbled_units_change_nothing_or_are_read_whole(
    seed: int, noise: bytes, flips: list[tuple[int, int]]
) -> None:
    scene = Scene.drawn(seed)
    maker, hearer = Group(scene.shape), Group(scene.shape)
    for _ in range(4):
        robot = int(scene.rng.integers(len(RANGES)))
        unit = scene.tell(maker, robot)
        if unit is None:
            continue
        garbled = bytearray(unit[0])
        for place, byte in flips:
            if garbled:
                garbled[place % len(garbled)] ^= byte
        stream, history = hearer.streams[robot], hearer.histories[robot]
        for wrong in (noise, bytes(garbled), unit[0][: len(unit[0]) // 2]):
            before, units = hearer.grids.copy(), len(history)
            try:
                heard = stream.decode(wrong)
            except ProtocolError as error:
                assert error.packet == "update"
                heard = None
            if heard is not None:
                stream.undo()
                history.pop()
            assert len(history) == units
            assert (hearer.grids == before).all()
        assert stream.decode(unit[0]) is not None
        assert (hearer.grids == maker.grids).all()


@pytest.mark.parametrize("size", [0, 1, 4, 16, 64, 1000])
def test_hostile_bytes_cost_bounded_time(size: int) -> None:
    grid = np.zeros((400, 400), np.uint8)
    scratch = np.empty((2 * grid.size, 2), np.int32)
    worst = 0.0
    for seed in range(6):
        stream = Stream(0, grid, ray_table(50.0, 360), [History()], scratch, team=False)
        message = bytes(size) if seed == 0 else np.random.default_rng(seed).bytes(size)
        began = time.process_time()
        try:
            stream.decode(message)
            stream.undo()
        except ProtocolError:
            pass
        worst = max(worst, time.process_time() - began)
        assert not grid.any()
    assert worst < 0.5


def test_a_unit_has_so_many_looks_at_most_and_what_is_left_can_be_told_in_the_next() -> None:
    shape = 3, 400
    maker, hearer = (Group(shape, team=False, ranges=(1.0,)) for _ in range(2))
    own = np.zeros(shape, np.uint8)
    own[1] = FREE
    poses = [(x, 1) for x in range(0, 400, 3)]
    while poses:
        unit = maker.streams[0].encode(own, poses, (0, 0, 400, 3))
        assert unit is not None
        message, _, looks = unit
        assert looks == min(MAX_LOOKS, len(poses))
        assert hearer.streams[0].decode(message) is not None
        poses = poses[looks:]
    assert (hearer.grids[0] & STATE).tolist() == own.tolist()


def test_where_nothing_is_left_to_tell_the_unit_before_can_still_be_taken_back() -> None:
    own = np.full((1, 500), FREE, np.uint8)
    stream = Group((1, 500), team=False, ranges=(3.0,)).streams[0]
    poses = [(x, 0) for x in (3, 7, *range(12, 7 * MAX_LOOKS, 7))][:MAX_LOOKS]
    poses.append((4, 0))  # from there nothing is to be seen that is not from one of the others
    own[0, poses[-2][0] + 4 :] = UNKNOWN
    unit = stream.encode(own, poses, (0, 0, 500, 1))
    assert unit is not None
    assert unit[2] == MAX_LOOKS
    assert stream.encode(own, poses[MAX_LOOKS:], (0, 0, 500, 1)) is None
    stream.undo()
    assert not stream.grid.any()
    stream.histories[0].pop()
    again = stream.encode(own, poses, (0, 0, 500, 1))
    assert again is not None
    assert again[0] == unit[0]


@given(seeds, st.integers(1, 40))
def test_what_a_short_unit_has_no_room_for_is_told_in_the_next_ones(seed: int, most: int) -> None:
    scene = Scene.drawn(seed)
    maker, hearer = Group(scene.shape), Group(scene.shape)
    height, width = scene.shape
    for _ in range(4):
        robot = int(scene.rng.integers(len(RANGES)))
        poses = scene.change(robot)
        looks = -1
        while looks < len(poses):
            poses = poses[max(looks, 0) :]
            unit = maker.streams[robot].encode(scene.own[robot], poses, (0, 0, width, height), most=most)
            if unit is None:
                break
            message, _, looks = unit
            assert hearer.streams[robot].decode(message) is not None
        else:
            assert hearer.follows(robot, scene.own[robot])
        assert (hearer.grids == maker.grids).all()


def test_the_shipped_table_speaks_of_contexts_that_there_are() -> None:
    counts = contexts.start()
    assert counts.shape == (contexts.CONTEXTS, 2)
    assert counts[: contexts.SEEN].sum(axis=1).max() < contexts.CELLS_MOST
    assert counts.sum(axis=1).max() < contexts.REST_MOST
    counts[:] = 0
    assert contexts.start().any(), "each stream has counts of its own"


@pytest.mark.parametrize(("cells", "at_most"), [(1, 6.0), (10, 3.0), (100, 2.0)])
def test_a_cell_that_is_not_as_expected_costs_some_two_bytes(cells: int, at_most: float) -> None:
    truth, walk = exploration()
    stream = Group((truth.shape[0], truth.shape[1]), team=False, ranges=(30.0,)).streams[0]
    height, width = truth.shape
    for own, pose in walk:
        stream.encode(own, [pose], (0, 0, width, height))
    noisy = walk[-1][0].copy()
    places = np.flatnonzero(noisy)[np.random.default_rng(4).permutation(np.count_nonzero(noisy))[:cells]]
    noisy.flat[places] = FREE + OCCUPIED - noisy.flat[places]
    unit = stream.encode(noisy, [walk[-1][1]], (0, 0, width, height))
    assert unit is not None
    assert 0.5 * cells <= len(unit[0]) <= at_most * cells
