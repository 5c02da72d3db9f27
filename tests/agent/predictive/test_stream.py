"""Streams: receivers decode every change of a self-explored grid; malformed updates change nothing."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.predictive import contexts
from agent.predictive.history import DecodedUpdate, History
from agent.predictive.scan_stream import NarrowBand, ScanStream
from agent.predictive.scan_updates import MAX_SCANS, REPORTED, STATE
from protocol.errors import ProtocolError
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid, ray_table
from protocol.scans import draw
from tests.agent.predictive.plain_predictive import PlainStream
from worldsim import generators
from worldsim.laser import cast

BEAMS = 36
RANGES = (5.0, 3.0, 7.0)
LONG = 1000
NARROW = NarrowBand(5.0, LONG)
seeds = st.integers(0, 2**32 - 1)
bands = st.sampled_from([None, NARROW, NarrowBand(0.0001, LONG), NarrowBand(300.0, LONG)])
short_bands = st.sampled_from([NarrowBand(5.0, limit) for limit in (1, 2, 5, 10, 20, 40)])

Cell = tuple[int, int]


class Group:
    """All streams, as one robot holds them."""

    def __init__(
        self,
        shape: tuple[int, int],
        *,
        team: bool = True,
        narrow: NarrowBand | None = None,
        ranges: tuple[float, ...] = RANGES,
    ) -> None:
        self.grids = np.zeros((len(ranges), *shape), np.uint8)
        self.histories = [History() for _ in ranges]
        scratch = np.empty((2 * shape[0] * shape[1], 2), np.int32)
        self.streams = [
            ScanStream(
                robot,
                self.grids[robot],
                ray_table(reach, BEAMS),
                self.histories,
                scratch,
                team=team,
                narrow=narrow,
            )
            for robot, reach in enumerate(ranges)
        ]

    def follows(self, robot: int, own: Grid) -> bool:
        """Whether a self-explored grid follows from the robot's stream."""
        grid = self.grids[robot]
        known = own != UNKNOWN
        return bool(((grid & STATE) == own)[known].all() and not (grid[~known] & REPORTED).any())


@dataclass
class Scene:
    """Robots whose grids change arbitrarily, and the cells from which they scan."""

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
        """Draw scans and change random cells in this robot's grid; return the cells it scanned from."""
        rng, own = self.rng, self.own[robot]
        height, width = own.shape
        truth = np.random.default_rng(3).choice((FREE, FREE, OCCUPIED), own.shape).astype(np.uint8)
        poses = [(int(rng.integers(width)), int(rng.integers(height))) for _ in range(rng.integers(0, 4))]
        no_robots = np.zeros(own.shape, np.bool_)
        beams = ray_table(RANGES[robot], BEAMS)
        for x, y in poses:
            if rng.random() < 0.8:
                draw(own, beams, x, y, cast(truth, no_robots, beams, x, y))
        for _ in range(rng.choice((0, 0, 1, 5, 40))):
            own[rng.integers(height), rng.integers(width)] = rng.integers(3)
        return poses

    def encode(self, group: Group, robot: int) -> tuple[bytes, DecodedUpdate] | None:
        height, width = self.shape
        update = group.streams[robot].encode(self.own[robot], self.change(robot), (0, 0, width, height))
        return None if update is None else update[:2]


@given(seeds, st.booleans(), bands)
def test_any_change_of_a_grid_is_coded_without_loss(seed: int, team: bool, narrow: NarrowBand | None) -> None:
    scene = Scene.drawn(seed)
    author, receiver = (Group(scene.shape, team=team, narrow=narrow) for _ in range(2))
    for _ in range(12):
        robot = int(scene.rng.integers(len(RANGES)))
        update = scene.encode(author, robot)
        if update is None:
            continue
        message, reported = update
        received = receiver.streams[robot].decode(message)
        assert received is not None
        assert received.places.tolist() == reported.places.tolist()
        assert received.states.tolist() == reported.states.tolist()
        assert receiver.follows(robot, scene.own[robot])
        assert (receiver.grids == author.grids).all()


@given(seeds)
def test_with_base_own_one_log_suffices_to_decode_the_grid(seed: int) -> None:
    scene = Scene.drawn(seed)
    author, receiver = Group(scene.shape, team=False), Group(scene.shape, team=False)
    for _ in range(6):
        if (update := scene.encode(author, 0)) is not None:
            receiver.streams[0].decode(update[0])
        assert (receiver.grids[0] & STATE).tolist() == scene.own[0].tolist()


@given(seeds)
def test_an_update_waits_for_its_dependencies_and_changes_nothing_until_then(seed: int) -> None:
    scene = Scene.drawn(seed)
    author, receiver = Group(scene.shape), Group(scene.shape)
    sent: list[list[bytes]] = [[] for _ in RANGES]
    for _ in range(15):
        robot = int(scene.rng.integers(len(RANGES)))
        if (update := scene.encode(author, robot)) is not None:
            sent[robot].append(update[0])
    while any(sent):
        waits = True
        for robot in scene.rng.permutation(len(RANGES)).tolist():
            before = receiver.grids.copy()
            if sent[robot]:
                if receiver.streams[robot].decode(sent[robot][0]) is None:
                    assert (receiver.grids == before).all()
                else:
                    del sent[robot][0]
                    waits = False
        assert not waits, "updates wait for each other"
    assert (receiver.grids == author.grids).all()


@given(seeds, bands | short_bands)
def test_a_rolled_back_update_leaves_no_trace(seed: int, narrow: NarrowBand | None) -> None:
    scene = Scene.drawn(seed)
    author, other = Group(scene.shape, narrow=narrow), Group(scene.shape, narrow=narrow)
    for _ in range(8):
        robot = int(scene.rng.integers(len(RANGES)))
        height, width = scene.shape
        whole = 0, 0, width, height
        poses = scene.change(robot)
        if author.streams[robot].encode(scene.own[robot], poses, whole) is not None:
            author.streams[robot].rollback()
            author.histories[robot].pop()
        poses += scene.change(robot)
        once, again = (
            group.streams[robot].encode(scene.own[robot], poses, whole) for group in (author, other)
        )
        assert (once is None) == (again is None)
        if once is not None and again is not None:
            assert once[0] == again[0]
        assert (author.grids == other.grids).all()


@given(seeds)
def test_an_update_equals_that_of_the_reference_coder(seed: int) -> None:
    scene = Scene.drawn(seed)
    author = Group(scene.shape, team=False)
    plain = PlainStream(scene.shape, ray_table(RANGES[0], BEAMS))
    height, width = scene.shape
    for _ in range(5):
        poses = scene.change(0)
        update = author.streams[0].encode(scene.own[0], poses, (0, 0, width, height))
        if update is not None:
            assert update[0] == plain.update(scene.own[0], poses)[0]
            assert (author.grids[0] & STATE).tolist() == plain.known.tolist()


def exploration(steps: int = 25) -> tuple[Grid, list[tuple[Grid, Cell]]]:
    """A walk through a generated office: after each step the self-explored grid and the cell of the robot."""
    truth = generators.make("office", width_m=12, height_m=12).cells
    no_robots, beams = np.zeros(truth.shape, np.bool_), ray_table(30.0, BEAMS)
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
        draw(own, beams, cell[1], cell[0], cast(truth, no_robots, beams, cell[1], cell[0]))
        walk.append((own.copy(), (cell[1], cell[0])))
    return truth, walk


def test_updates_are_within_3_percent_and_half_a_byte_of_their_entropy() -> None:
    truth, walk = exploration()
    stream = Group((truth.shape[0], truth.shape[1]), team=False, ranges=(30.0,)).streams[0]
    plain = PlainStream((truth.shape[0], truth.shape[1]), ray_table(30.0, BEAMS))
    height, width = truth.shape
    sizes, ideal = 0, 0.0
    count = 0
    for own, pose in walk:
        update = stream.encode(own, [pose], (0, 0, width, height))
        if update is not None:
            message, bits = plain.update(own, [pose])
            assert update[0] == message
            sizes, ideal, count = sizes + len(message), ideal + bits / 8, count + 1
    assert count > 10
    assert sizes <= 1.03 * ideal + 0.6 * count


def test_a_scan_of_an_office_takes_a_hundredth_of_its_readings() -> None:
    truth, walk = exploration()
    stream = Group((truth.shape[0], truth.shape[1]), team=False, ranges=(30.0,)).streams[0]
    height, width = truth.shape
    updates = [stream.encode(own, [pose], (0, 0, width, height)) for own, pose in walk]
    reported = sum(len(update[0]) for update in updates if update is not None)
    assert reported < len(walk) * 2 * (BEAMS + 2) / 4


messages = st.binary(max_size=64)


@given(
    seeds,
    messages,
    st.lists(st.tuples(st.integers(0, 63), st.integers(0, 255)), max_size=3),
    bands | short_bands,
)
def test_noise_and_damaged_updates_change_nothing_or_decode_fully(
    seed: int, noise: bytes, flips: list[tuple[int, int]], narrow: NarrowBand | None
) -> None:
    scene = Scene.drawn(seed)
    author, receiver = (Group(scene.shape, narrow=narrow) for _ in range(2))
    for _ in range(4):
        robot = int(scene.rng.integers(len(RANGES)))
        update = scene.encode(author, robot)
        if update is None:
            continue
        garbled = bytearray(update[0])
        for place, byte in flips:
            if garbled:
                garbled[place % len(garbled)] ^= byte
        stream, history = receiver.streams[robot], receiver.histories[robot]
        for wrong in (noise, bytes(garbled), update[0][: len(update[0]) // 2]):
            before, updates = receiver.grids.copy(), len(history)
            try:
                received = stream.decode(wrong)
            except ProtocolError as error:
                assert error.packet == "update"
                received = None
            if received is not None:
                stream.rollback()
                history.pop()
            assert len(history) == updates
            assert (receiver.grids == before).all()
        assert stream.decode(update[0]) is not None
        assert (receiver.grids == author.grids).all()


@pytest.mark.parametrize("narrow", [None, NARROW, NarrowBand(5.0, 15)])
@pytest.mark.parametrize("size", [0, 1, 4, 16, 64, 1000])
def test_hostile_bytes_cost_bounded_time(size: int, narrow: NarrowBand | None) -> None:
    grid = np.zeros((400, 400), np.uint8)
    scratch = np.empty((2 * grid.size, 2), np.int32)
    worst = 0.0
    for seed in range(6):
        stream = ScanStream(0, grid, ray_table(50.0, 360), [History()], scratch, team=False, narrow=narrow)
        message = bytes(size) if seed == 0 else np.random.default_rng(seed).bytes(size)
        began = time.process_time()
        try:
            stream.decode(message)
            stream.rollback()
        except ProtocolError:
            pass
        worst = max(worst, time.process_time() - began)
        assert not grid.any()
    assert worst < 0.5


def test_an_update_has_at_most_max_scans_and_the_next_one_has_the_rest() -> None:
    shape = 3, 400
    author, receiver = (Group(shape, team=False, ranges=(1.0,)) for _ in range(2))
    own = np.zeros(shape, np.uint8)
    own[1] = FREE
    poses = [(x, 1) for x in range(0, 400, 3)]
    while poses:
        update = author.streams[0].encode(own, poses, (0, 0, 400, 3))
        assert update is not None
        message, _, scans = update
        assert scans == min(MAX_SCANS, len(poses))
        assert receiver.streams[0].decode(message) is not None
        poses = poses[scans:]
    assert (receiver.grids[0] & STATE).tolist() == own.tolist()


def test_cells_that_an_incomplete_update_left_to_a_teammate_are_not_repeated() -> None:
    group = Group((3, 400), ranges=(1.0, 1.0))
    own = np.zeros((3, 400), np.uint8)
    own[1, :150] = FREE
    poses, box = [(x, 1) for x in range(1, 150, 3)], (0, 0, 150, 3)
    incomplete = group.streams[0].encode(own, poses, box, most=1)
    assert incomplete is not None
    assert incomplete[2] == 1
    complete = group.streams[1].encode(own, poses, box)
    assert complete is not None
    assert complete[2] == len(poses)
    own[1, 300:303] = FREE
    last = group.streams[0].encode(own, [(301, 1)], (300, 1, 303, 2))
    assert last is not None
    assert sorted(last[1].places.tolist()) == [700, 701, 702]
    assert group.follows(0, own)


def test_on_narrow_media_a_scan_is_left_out_if_earlier_ones_reveal_its_cells() -> None:
    own = np.full((1, 40), FREE, np.uint8)
    messages = []
    for poses in ([(3, 0), (5, 0), (7, 0)], [(3, 0), (7, 0)]):
        stream = Group((1, 40), team=False, narrow=NARROW, ranges=(3.0,)).streams[0]
        update = stream.encode(own, poses, (0, 0, 11, 1))
        assert update is not None
        assert update[2] == len(poses)
        messages.append(update[0])
    assert messages[0] == messages[1]


def test_updates_of_a_walk_are_shorter_on_narrow_media() -> None:
    truth, walk = exploration(120)
    sizes = []
    for band in (None, NarrowBand(5.0, 15)):
        author = Group((truth.shape[0], truth.shape[1]), team=False, narrow=band, ranges=(30.0,)).streams[0]
        receiver = Group((truth.shape[0], truth.shape[1]), team=False, narrow=band, ranges=(30.0,)).streams[0]
        own, size = walk[-1][0], 0
        poses = [pose for _, pose in walk]
        while poses:
            update = author.encode(own, poses, (0, 0, truth.shape[1], truth.shape[0]), most=15)
            if update is None:
                break
            assert receiver.decode(update[0]) is not None
            size += len(update[0])
            poses = poses[update[2] :]
        assert ((receiver.grid & STATE) == own).all()
        sizes.append(size)
    assert sizes[1] < 0.8 * sizes[0]


@pytest.mark.parametrize("limit", [8, 10, 15])
def test_on_narrow_media_an_update_ends_at_its_limit_and_the_next_one_has_the_rest(limit: int) -> None:
    truth, walk = exploration(60)
    shape, band = (truth.shape[0], truth.shape[1]), NarrowBand(5.0, limit)
    author, receiver = (Group(shape, team=False, narrow=band, ranges=(30.0,)).streams[0] for _ in range(2))
    own, poses, sizes = walk[-1][0], [pose for _, pose in walk], []
    while poses:
        update = author.encode(own, poses, (0, 0, shape[1], shape[0]))
        if update is None:
            break
        assert receiver.decode(update[0]) is not None
        sizes.append(len(update[0]))
        poses = poses[update[2] :]
    assert ((receiver.grid & STATE) == own).all()
    assert len(sizes) > 1
    assert max(sizes) <= limit + 1
    assert min(sizes[:-1]) >= limit - 2


@given(seeds)
def test_dependencies_on_narrow_media_include_those_of_the_bases(seed: int) -> None:
    scene = Scene.drawn(seed)
    author, receiver = (Group(scene.shape, narrow=NARROW) for _ in range(2))
    for _ in range(15):
        robot = int(scene.rng.integers(len(RANGES)))
        if (update := scene.encode(author, robot)) is None:
            continue
        received = receiver.streams[robot].decode(update[0])
        assert received is not None
        assert received.ends == update[1].ends
        for base in received.bases:
            last = receiver.histories[base.map_id].between(base.end - 1, base.end)[0]
            others = [each for each in range(len(RANGES)) if each != robot]
            assert received.ends[base.map_id] >= base.end
            assert all(received.ends[each] >= last.ends[each] for each in others)


def test_an_empty_update_leaves_the_one_before_it_retractable() -> None:
    own = np.full((1, 500), FREE, np.uint8)
    stream = Group((1, 500), team=False, ranges=(3.0,)).streams[0]
    poses = [(x, 0) for x in (3, 7, *range(12, 7 * MAX_SCANS, 7))][:MAX_SCANS]
    poses.append((4, 0))  # from there nothing is to be seen that is not from one of the others
    own[0, poses[-2][0] + 4 :] = UNKNOWN
    update = stream.encode(own, poses, (0, 0, 500, 1))
    assert update is not None
    assert update[2] == MAX_SCANS
    assert stream.encode(own, poses[MAX_SCANS:], (0, 0, 500, 1)) is None
    stream.rollback()
    assert not stream.grid.any()
    stream.histories[0].pop()
    again = stream.encode(own, poses, (0, 0, 500, 1))
    assert again is not None
    assert again[0] == update[0]


@given(seeds, st.integers(1, 40), bands | short_bands)
def test_a_size_limit_defers_scans_to_the_next_updates(
    seed: int, most: int, narrow: NarrowBand | None
) -> None:
    scene = Scene.drawn(seed)
    author, receiver = (Group(scene.shape, narrow=narrow) for _ in range(2))
    height, width = scene.shape
    for _ in range(4):
        robot = int(scene.rng.integers(len(RANGES)))
        poses, stream = scene.change(robot), author.streams[robot]
        scans = -1
        while scans < len(poses) or stream.is_cut:
            poses = poses[max(scans, 0) :]
            update = stream.encode(scene.own[robot], poses, (0, 0, width, height), most=most)
            if update is None:
                break
            message, reported, scans = update
            received = receiver.streams[robot].decode(message)
            assert received is not None
            assert received.places.tolist() == reported.places.tolist()
            assert received.states.tolist() == reported.states.tolist()
        else:
            assert receiver.follows(robot, scene.own[robot])
        assert (receiver.grids == author.grids).all()


@pytest.mark.parametrize("narrow", [False, True])
def test_the_shipped_table_fits_the_contexts(narrow: bool) -> None:
    counts = contexts.start(narrow=narrow)
    assert counts.shape == (contexts.CONTEXTS, 2)
    assert counts[: contexts.OBSERVED].sum(axis=1).max() < contexts.CELLS_MOST
    assert counts.sum(axis=1).max() < contexts.REST_MOST
    counts[:] = 0
    assert contexts.start(narrow=narrow).any(), "each stream has counts of its own"


@pytest.mark.parametrize(("cells", "at_most"), [(1, 6.0), (10, 3.0), (100, 2.0)])
def test_a_correction_takes_about_two_bytes(cells: int, at_most: float) -> None:
    truth, walk = exploration()
    stream = Group((truth.shape[0], truth.shape[1]), team=False, ranges=(30.0,)).streams[0]
    height, width = truth.shape
    for own, pose in walk:
        stream.encode(own, [pose], (0, 0, width, height))
    noisy = walk[-1][0].copy()
    places = np.flatnonzero(noisy)[np.random.default_rng(4).permutation(np.count_nonzero(noisy))[:cells]]
    noisy.flat[places] = FREE + OCCUPIED - noisy.flat[places]
    update = stream.encode(noisy, [walk[-1][1]], (0, 0, width, height))
    assert update is not None
    assert 0.5 * cells <= len(update[0]) <= at_most * cells
