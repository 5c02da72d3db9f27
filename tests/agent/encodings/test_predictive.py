"""The predictive exchange: what a robot's units say is what it has seen, in whatever order and fragments they come."""

from __future__ import annotations

import contextlib
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from agent.encodings.predictive import ENOUGH_STEPS, PredictiveEncoding, fragments
from agent.settings import Settings
from protocol.errors import ProtocolError
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid, ray_table
from protocol.packets import LAST_UPDATE_DATA, UPDATE_DATA, Delete, Fragment, Update, encode, update_fragment
from protocol.scans import Change, Scan, draw
from tests.agent.encodings.arrival import LATE
from worldsim.laser import cast

BEAMS = 36
RANGES = [6.0, 3.5, 9.0]
WIDTH, HEIGHT = 20, 14
seeds = st.integers(0, 2**32 - 1)


def settings_of(robot: int, **more: Any) -> Settings:
    return Settings(
        robot=robot, robots=3, width=WIDTH, height=HEIGHT, ranges_cells=RANGES, beams=BEAMS, speed_cells=1.0,
        seed=0, map_encoding="predictive", strategy="meier", dissemination="gossip", reach_cells=math.inf,
        **({"bandwidth": None} | more),
    )  # fmt: skip


class Explorer:
    """A robot that looks around from anywhere, and its exchange."""

    def __init__(self, robot: int, seed: int, common: dict[str, Any] | None = None, **more: Any) -> None:
        self.robot = robot
        self.map_encoding = PredictiveEncoding(settings_of(robot, **more))
        if common is not None:
            self.map_encoding.use_shared_cache(common)
        self.own: Grid = np.zeros((HEIGHT, WIDTH), np.uint8)
        self.rng = np.random.default_rng([seed, robot])
        self.log: list[bytes] = []

    def look(self, truth: Grid, *, delivered: bool = True, noise: int = 0) -> list[bytes]:
        """Take a scan, spoil some cells of what is known, and log what there is to tell."""
        nobody, beams = np.zeros(truth.shape, np.bool_), ray_table(RANGES[self.robot], BEAMS)
        x, y = int(self.rng.integers(WIDTH)), int(self.rng.integers(HEIGHT))
        readings = cast(truth, nobody, beams, x, y)
        change = draw(self.own, beams, x, y, readings)
        for _ in range(noise):
            at_x, at_y = int(self.rng.integers(WIDTH)), int(self.rng.integers(HEIGHT))
            self.own[at_y, at_x] = self.rng.choice((FREE, OCCUPIED))
            cells, (x0, y0, x1, y1) = change
            far = max(x1, at_x + 1), max(y1, at_y + 1)
            change = Change(cells + 1, (min(x0, at_x), min(y0, at_y), *far))
        units = self.map_encoding.encode_changes(self.own, Scan(x, y, readings), change, delivered=delivered)
        self.log += units
        return units


def world(seed: int) -> Grid:
    rng = np.random.default_rng(seed)
    return np.where(rng.random((HEIGHT, WIDTH)) < 0.85, FREE, OCCUPIED).astype(np.uint8)


def flush(explorer: Explorer) -> list[bytes]:
    """Let a robot stand still until it has told all."""
    said: list[bytes] = []
    nothing = Change(0, (WIDTH, HEIGHT, 0, 0))
    for _ in range(ENOUGH_STEPS):
        scan = Scan(0, 0, np.full(BEAMS, 0, np.uint16))
        said += explorer.map_encoding.encode_changes(explorer.own, scan, nothing, delivered=True)
    explorer.log += said
    return said


def unknown() -> Grid:
    return np.zeros((HEIGHT, WIDTH), np.uint8)


@given(seeds, st.sampled_from(("team", "own")), st.sampled_from((0, 0, 3)))
def test_all_that_a_team_has_seen_is_what_each_of_them_knows(seed: int, base: str, noise: int) -> None:
    truth = world(seed)
    team = [Explorer(robot, seed, predictive={"base": base}) for robot in range(3)]
    for _ in range(6):
        said = [(each.robot, each.look(truth, noise=noise)) for each in team]
        for each in team:
            for robot, units in said:
                if robot != each.robot:
                    each.map_encoding.apply(robot, b"".join(units), **LATE)
    last = [(each.robot, flush(each)) for each in team]
    for each in team:
        for robot, units in last:
            if robot != each.robot:
                each.map_encoding.apply(robot, b"".join(units), **LATE)
    told = [each.map_encoding.merge(unknown()) for each in team]
    assert all((grid == told[0]).all() for grid in told)
    seen = [each.own for each in team]
    assert ((told[0] != UNKNOWN) == np.any([own != UNKNOWN for own in seen], axis=0)).all()
    assert np.any([(told[0] == own) for own in seen], axis=0).all()
    if not noise or base == "own":
        assert (told[0] == np.max(seen, axis=0)).all()
    for each in team:
        planning = each.map_encoding.merge(each.own)
        assert (planning[each.own != UNKNOWN] == each.own[each.own != UNKNOWN]).all()


@given(seeds, st.integers(0, 2**32 - 1))
def test_units_in_pieces_and_in_any_order_of_maps_say_the_same(seed: int, order: int) -> None:
    truth = world(seed)
    makers = [Explorer(robot, seed) for robot in (0, 1)]
    for _ in range(6):
        for maker, other in (makers, makers[::-1]):
            other.map_encoding.apply(maker.robot, b"".join(maker.look(truth)), **LATE)
    for maker, other in (makers, makers[::-1]):
        other.map_encoding.apply(maker.robot, b"".join(flush(maker)), **LATE)
    hearer, rng = PredictiveEncoding(settings_of(2)), np.random.default_rng(order)
    logs = [list(maker.log) for maker in makers]
    while any(logs):
        robot = int(rng.integers(2))
        count = int(rng.integers(1, 4))
        hearer.apply(robot, b"".join(logs[robot][:count]), **LATE)
        del logs[robot][:count]
    assert (hearer.merge(unknown()) == np.max([maker.own for maker in makers], axis=0)).all()


@given(seeds)
def test_what_waited_for_the_medium_is_told_in_one_unit_later(seed: int) -> None:
    truth = world(seed)
    maker, hearer = Explorer(0, seed), PredictiveEncoding(settings_of(1))
    for _ in range(5):
        assert maker.look(truth, delivered=False) == []
    units = maker.look(truth)
    assert sum(update_fragment(unit)[0] is not None for unit in units) == 1
    hearer.apply(0, b"".join(units), **LATE)
    assert (hearer.merge(unknown()) == maker.own).all()


@given(seeds)
def test_on_a_narrow_medium_it_is_told_in_several_units_one_a_step(seed: int) -> None:
    truth = world(seed)
    maker, hearer = Explorer(0, seed, bandwidth=6), PredictiveEncoding(settings_of(1))
    for _ in range(5):
        assert maker.look(truth, delivered=False) == []
    units = 0
    while said := flush(maker):
        hearer.apply(0, b"".join(said), **LATE)
        units += sum(update_fragment(unit)[0] is not None for unit in said)
    assert (hearer.merge(unknown()) == maker.own).all()
    assert units > 1 or np.count_nonzero(maker.own) < 100


@given(seeds, st.booleans())
def test_what_a_unit_is_built_on_is_known_to_its_maker_and_to_all_who_have_read_it(
    seed: int, taken_back: bool
) -> None:
    truth = world(seed)
    first, second, hearer = Explorer(0, seed), Explorer(1, seed), PredictiveEncoding(settings_of(2))
    for _ in range(6):
        second.map_encoding.apply(0, b"".join(first.look(truth)), **LATE)
        units = second.look(truth)
        if taken_back and second.map_encoding.retractable:
            second.map_encoding.retract_last()
            del second.log[len(second.log) - len(units) :]
        else:
            first.map_encoding.apply(1, b"".join(units), **LATE)
    bases = second.map_encoding.dependencies(1)
    assert list(first.map_encoding.dependencies(1)) == list(bases)
    read = [0, 0]
    for first_unit, end, on in bases:  # with what they say, and no more, each unit can be read
        assert read[1] <= first_unit < end <= len(second.log)
        for map_id, log, units in (*((0, first.log, units) for _, units in on), (1, second.log, end)):
            hearer.apply(map_id, b"".join(log[read[map_id] : units]), **LATE)
            read[map_id] = max(read[map_id], units)
        assert hearer.dependencies(1)[-1].end == end


@given(seeds)
def test_a_unit_that_nobody_has_heard_is_taken_back_and_what_it_said_is_in_the_next(seed: int) -> None:
    truth = world(seed)
    maker, hearer = Explorer(0, seed), PredictiveEncoding(settings_of(1))
    units = maker.look(truth)
    assume(units)
    assert maker.map_encoding.retractable == len(units)
    maker.map_encoding.retract_last()
    assert not maker.map_encoding.merge(unknown()).any()
    hearer.apply(0, b"".join(maker.look(truth)), **LATE)
    assert (hearer.merge(unknown()) == maker.own).all()


def test_a_look_that_shows_nothing_new_to_all_is_not_told() -> None:
    truth = np.full((HEIGHT, WIDTH), FREE, np.uint8)
    first, second = Explorer(2, 1), Explorer(0, 1)
    for _ in range(40):
        second.map_encoding.apply(2, b"".join(first.look(truth)), **LATE)
    second.map_encoding.apply(2, b"".join(flush(first)), **LATE)
    assert (second.map_encoding.merge(unknown()) == FREE).all()
    assert [second.look(truth) for _ in range(5)] == 5 * [[]]
    assert second.own.any()


@pytest.mark.parametrize(("bandwidth", "steps"), [(None, 0), (1000.0, 0), (50.0, 1), (25.0, 3), (1.0, 3)])
def test_few_new_cells_wait_for_a_few_steps_where_bytes_are_scarce(
    bandwidth: float | None, steps: int
) -> None:
    truth = np.full((HEIGHT, WIDTH), OCCUPIED, np.uint8)
    truth[5, 5] = FREE
    explorer = Explorer(0, 0, bandwidth=bandwidth)
    nobody, beams = np.zeros(truth.shape, np.bool_), ray_table(RANGES[0], BEAMS)
    scan = Scan(5, 5, cast(truth, nobody, beams, 5, 5))
    own = unknown()
    own[5, 5] = FREE
    said = [
        explorer.map_encoding.encode_changes(own, scan, Change(1, (5, 5, 6, 6)), delivered=True)
        for _ in range(ENOUGH_STEPS)
    ]
    assert [bool(units) for units in said].index(True) == steps


@given(seeds, st.sampled_from(("team", "own")), st.booleans())
def test_robots_that_read_together_know_what_each_would_know_alone(seed: int, base: str, lies: bool) -> None:
    """At their own pace, with units that were taken back; a liar tells each of them something else."""
    truth, rng = world(seed), np.random.default_rng(seed)
    teams = [
        [Explorer(robot, seed, common, predictive={"base": base}) for robot in range(3)]
        for common in (None, {})
    ]
    told = [[0] * 3 for _ in range(3)]
    for _ in range(12):
        speaker = int(rng.integers(3))
        lost, noise, wrong = rng.random() < 0.3, int(rng.integers(4)), rng.random() < 0.5
        for team in teams:
            maker = team[speaker]
            if (
                lost
                and maker.map_encoding.retractable
                and all(told[to][speaker] < len(maker.log) for to in range(3))
            ):
                del maker.log[len(maker.log) - maker.map_encoding.retractable :]
                maker.map_encoding.retract_last()
            maker.look(truth, noise=noise)
        assert teams[0][speaker].log == teams[1][speaker].log
        hearer, map_id = int(rng.integers(3)), int(rng.integers(3))
        heard = teams[0][map_id].log[told[hearer][map_id] :][: int(rng.integers(4))]
        if hearer == map_id or not heard:
            continue
        told[hearer][map_id] += len(heard)
        if lies and map_id == 2 and wrong:
            number, data = update_fragment(heard[0])
            heard[0] = encode([Update(number, bytes(byte ^ hearer + 1 for byte in data))])
        said = []
        for team in teams:
            try:
                team[hearer].map_encoding.apply(map_id, b"".join(heard), **LATE)
            except ProtocolError as error:
                said.append(str(error))
            else:
                said.append("")
        assert said[0] == said[1]
        for alone, together in zip(*teams, strict=True):
            assert (alone.map_encoding.merge(unknown()) == together.map_encoding.merge(unknown())).all()
            assert [alone.map_encoding.scan_cell(robot) for robot in range(3)] == [
                together.map_encoding.scan_cell(robot) for robot in range(3)
            ]


def units_of(seed: int) -> list[bytes]:
    maker = Explorer(0, seed)
    units: list[bytes] = []
    for _ in range(3):
        units += maker.look(world(seed))
    return units


WRONG = {
    "another kind": [encode([Delete(3)])],
    "a raw scan": [encode([Fragment(b"scan")])],
    "another unit than the next": [encode([Update(3, b"\x12\x34")])],
    "bytes that are no unit": [encode([Update(0, bytes(range(40)))])],
}


@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("behind", [False, True])
def test_nonsense_is_refused_and_changes_nothing(wrong: str, behind: bool) -> None:
    hearer = PredictiveEncoding(settings_of(1))
    units = units_of(5)
    head = units[:1] if behind and update_fragment(units[0])[0] is None else []
    hearer.apply(0, b"".join(head), **LATE)
    before = hearer.merge(unknown())
    with pytest.raises(ProtocolError):
        hearer.apply(
            0,
            b"".join([*head, *WRONG[wrong]] if wrong == "bytes that are no unit" and head else WRONG[wrong]),
            **LATE,
        )
    assert (hearer.merge(unknown()) == before).all()
    hearer.apply(0, b"".join(units[len(head) :]), **LATE)
    assert hearer.merge(unknown()).any()


@given(st.lists(st.tuples(st.integers(0, 1), st.binary(max_size=LAST_UPDATE_DATA)), max_size=12), seeds)
def test_a_liar_changes_no_other_map_whatever_it_says(lies: list[tuple[int, bytes]], seed: int) -> None:
    truth = world(seed)
    maker, hearer = Explorer(0, seed), PredictiveEncoding(settings_of(1))
    plain = PredictiveEncoding(settings_of(1))
    for number, (_, data) in enumerate(lies):
        units = maker.look(truth)
        with contextlib.suppress(ProtocolError):
            hearer.apply(2, encode([Update(number % 4, data)]), **LATE)
        hearer.apply(0, b"".join(units), **LATE)
        plain.apply(0, b"".join(units), **LATE)
    known = plain.merge(unknown())
    assert (hearer.merge(unknown())[known == OCCUPIED] == OCCUPIED).all()
    assert (hearer.merge(unknown())[known == FREE] != UNKNOWN).all()


@given(st.binary(max_size=300), st.integers(0, 100), st.integers(UPDATE_DATA, LAST_UPDATE_DATA))
def test_pieces_give_back_the_unit(message: bytes, number: int, most: int) -> None:
    cut = [update_fragment(piece) for piece in fragments(message, number, most)]
    assert b"".join(data for _, data in cut) == message
    assert [said for said, _ in cut] == [None] * (len(cut) - 1) + [number % 4]
    assert len(cut[-1][1]) <= most


@given(seeds, st.booleans())
def test_retracting_an_update_on_which_another_log_claims_to_depend_is_safe(seed: int, shared: bool) -> None:
    """A forger guesses an update that was never sent, and sends an update that depends on it."""
    truth = world(seed)
    cache: dict[str, Any] | None = {} if shared else None
    victim, forger, third = Explorer(0, seed, cache), Explorer(1, seed), PredictiveEncoding(settings_of(2))
    unsent = victim.look(truth)
    assume(unsent)
    forger.map_encoding.apply(0, b"".join(unsent), **LATE)
    forged = forger.look(truth)
    assume(forger.map_encoding.dependencies(1))
    victim.map_encoding.apply(1, b"".join(forged), **LATE)
    for _ in range(4):
        victim.map_encoding.merge(victim.own)
        if retractable := victim.map_encoding.retractable:
            victim.map_encoding.retract_last()
            del victim.log[len(victim.log) - retractable :]
        victim.look(truth)
    flush(victim)
    third.apply(1, b"".join(forged), **LATE)
    third.apply(0, b"".join(victim.log), **LATE)
    assert (third.merge(unknown()) == victim.map_encoding.merge(unknown())).all()
