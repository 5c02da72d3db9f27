"""The receiving end: cut streams, hostile streams, and that only a save point counts."""

from __future__ import annotations

from contextlib import suppress
from copy import deepcopy
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.memo_cache import MemoCache
from agent.outline.approximation import approximation, repair
from agent.outline.claims import THESIS, Drawing, Drawn, draw_anew, layer
from agent.outline.contour import contours
from agent.outline.draft import Draft, Outline
from agent.outline.edits import Held, edit_script
from agent.outline.merge import rendered
from agent.outline.objects import symbols
from agent.outline.polygons import Polygons
from agent.outline.receiver import Receiver
from agent.outline.simplify import refine
from protocol.errors import ProtocolError
from protocol.packets import (
    MAX_OBJECTS,
    MAX_VERTICES,
    Answer,
    Change,
    Delete,
    Emerge,
    Insert,
    Packet,
    Remove,
    Replace,
    Save,
    Target,
    encode,
)
from tests.agent.explorations import exploration, growing_maps, real_map

quick = settings(deadline=None)

SHAPE = (6, 8)
SQUARE = [Emerge(0, 4, 1), *(Insert(i, i, 1, 0, 0) for i in range(4)), Save()]


def told(splits: int | None, steps: list[tuple[np.ndarray, tuple[int, int]]]) -> list[tuple[bytes, Polygons]]:
    """What a robot says in each step, and the approximation that it means."""
    held = Held.nothing(steps[0][0].shape)
    said = []
    for grid, robot in steps:
        exact = contours(grid, robot)
        coarse = approximation(exact, refine(exact, repair(held.polygons, exact), splits))
        packets, held = edit_script(held, coarse)
        all_kinds: list[Packet] = list(packets)
        said.append((encode(all_kinds), coarse))
    return said


@cache
def real_story() -> list[tuple[bytes, Polygons]]:
    return told(3, list(exploration(real_map("fr079"), np.random.default_rng(6), 60, 60.0)))


def state(receiver: Receiver) -> tuple[list[int], list[list[int]]]:
    held = receiver.held
    p = held.polygons
    return held.number.tolist(), [
        column.tolist() for column in (p.x, p.y, p.side, p.occupied, p.start, p.inside)
    ]


def assert_well_formed(receiver: Receiver, shape: tuple[int, int]) -> None:
    p = receiver.held.polygons
    if p.objects:
        assert p.inside.sum() == 1
        assert (np.diff(p.start) >= 2).all()
        assert (np.diff(p.start) <= MAX_VERTICES).all()
        assert (p.x >= -1).all()
        assert (p.x <= shape[1]).all()
        assert (p.y >= -1).all()
        assert (p.y <= shape[0]).all()
    assert rendered(p).shape == shape


def test_what_comes_behind_a_save_point_in_the_same_piece_is_not_used_yet() -> None:
    receiver = Receiver(SHAPE)
    pair = [Emerge(1, 2, 0), *(Insert(i, 3 + i, 3, 0, 0) for i in range(2))]
    receiver.feed(encode([*SQUARE[:-1], *pair, Save()]))
    assert state(receiver)[0] == [0, 1]
    receiver.feed(encode([Change(0, 3, 1), Delete(0), Save(), Remove(1)]))
    assert state(receiver)[0] == [0, 1]
    receiver.feed(encode([Save()]))
    assert state(receiver)[0] == [0]


def pieces(data: bytes, cuts: list[int]) -> list[bytes]:
    edges = [0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]
    return [data[a:b] for a, b in pairwise(edges)]


@quick
@given(growing_maps(), st.sampled_from([0, 2, None]))
def test_at_every_save_point_the_receiver_holds_what_the_sender_means(
    steps: list[tuple[np.ndarray, tuple[int, int]]], splits: int | None
) -> None:
    receiver = Receiver(steps[0][0].shape)
    for data, approximated in told(splits, steps):
        assert receiver.feed(data) == bool(data)
        assert receiver.held.polygons.canonical() == approximated.canonical()


@quick
@given(growing_maps(), st.lists(st.integers(0, 2**20), max_size=12))
def test_a_stream_that_is_cut_anywhere_ends_in_the_same_state(
    steps: list[tuple[np.ndarray, tuple[int, int]]], cuts: list[int]
) -> None:
    said = told(1, steps)
    receiver = Receiver(steps[0][0].shape)
    for piece in pieces(b"".join(data for data, _ in said), cuts):
        receiver.feed(piece)
    assert receiver.held.polygons.canonical() == said[-1][1].canonical()


def test_a_real_stream_byte_by_byte_shows_nothing_but_saved_states() -> None:
    receiver = Receiver(real_map("fr079").shape)
    nothing = receiver.held
    for data, approximated in real_story():
        before = receiver.held
        saves = [receiver.feed(data[i : i + 1]) or receiver.held is not before for i in range(len(data))]
        assert not any(saves[:-1]), "a half-sent step is never shown"
        assert receiver.held.polygons.canonical() == approximated.canonical()
    assert receiver.held is not nothing


@quick
@given(st.binary(max_size=200), st.lists(st.integers(0, 2**20), max_size=4))
def test_random_bytes_never_change_a_saved_state(noise: bytes, cuts: list[int]) -> None:
    receiver = Receiver(SHAPE)
    receiver.feed(encode(SQUARE))
    for piece in pieces(noise, cuts):
        before = state(receiver)
        try:
            saved = receiver.feed(piece)
        except ProtocolError:
            saved = False
        assert saved or state(receiver) == before
        assert_well_formed(receiver, SHAPE)


small = st.integers(0, 5)
vertex = st.integers(-1, 9), st.integers(-1, 7), st.integers(0, 3), st.integers(0, 1)
hostile = st.one_of(
    st.builds(Insert, small, *vertex),
    st.builds(Replace, small, *vertex),
    st.builds(Delete, small),
    st.builds(Emerge, small, st.integers(0, 6) | st.sampled_from([4097, 8191]), st.integers(0, 1)),
    st.builds(Change, small, st.integers(0, 6) | st.sampled_from([4097, 8191]), st.integers(0, 1)),
    st.builds(Remove, small),
    st.just(Save()),
    st.builds(Answer, small),
    st.builds(Target, small, small),
)


@quick
@given(st.lists(st.lists(hostile, max_size=6), max_size=30))
def test_packets_that_make_no_sense_never_change_a_saved_state(streams: list[list[Packet]]) -> None:
    receiver = Receiver(SHAPE)
    receiver.feed(encode(SQUARE))
    for packets in streams:
        before = state(receiver)
        try:
            saved = receiver.feed(encode(packets))
        except ProtocolError as error:
            assert error.reason
            saved = False
        assert saved or state(receiver) == before
        assert_well_formed(receiver, SHAPE)


@st.composite
def nearly_right(draw: st.DrawFn) -> list[Packet]:
    """A step's edits to `SQUARE` that may be right, or wrong in one place."""
    edits = draw(st.lists(hostile.filter(lambda p: isinstance(p, Insert | Replace | Delete)), max_size=5))
    grown = sum(isinstance(p, Insert) for p in edits) - sum(isinstance(p, Delete) for p in edits)
    packets: list[Packet] = [Change(0, max(0, 4 + grown), 1), *edits]
    if draw(st.booleans()):
        packets += [Emerge(2, 3, 0), *(Insert(i, *draw(st.tuples(*vertex))) for i in range(3))]
    packets.append(Save())
    if draw(st.booleans()):
        at = draw(st.integers(0, len(packets)))
        packets[at : at + draw(st.integers(0, 1))] = [draw(hostile)]
    return packets


@quick
@given(nearly_right())
def test_a_step_that_is_nearly_right_is_taken_whole_or_not_at_all(packets: list[Packet]) -> None:
    receiver = Receiver(SHAPE)
    receiver.feed(encode(SQUARE))
    before = state(receiver)
    try:
        saved = receiver.feed(encode(packets))
        assert saved or state(receiver) == before
    except ProtocolError:
        assert state(receiver) == before
        assert receiver.feed(encode([Change(0, 2, 1), *[Delete(0)] * 2, Save()]))
    assert_well_formed(receiver, SHAPE)


@quick
@given(st.integers(0, 58), st.data())
def test_after_a_damaged_piece_the_whole_one_still_leads_on(step: int, data: st.DataObject) -> None:
    said = real_story()
    shape = real_map("fr079").shape
    receiver = Receiver(shape)
    for piece, _ in said[:step]:
        receiver.feed(piece)
    begun = data.draw(st.integers(0, len(said[step][0])))
    receiver.feed(said[step][0][:begun])
    rest = said[step][0][begun:]
    damaged = bytearray(rest)
    for _ in range(data.draw(st.integers(1, 4))):
        if damaged:
            damaged[data.draw(st.integers(0, len(damaged) - 1))] ^= data.draw(st.integers(1, 255))
    before = state(receiver)
    try:
        receiver.feed(bytes(damaged) + b"\xff")
    except ProtocolError:
        assert state(receiver) == before
        receiver.feed(rest)
        assert receiver.held.polygons.canonical() == said[step][1].canonical()
    assert_well_formed(receiver, shape)


def plainly(objects: dict[int, Outline]) -> list[tuple[int, list[int], bool]]:
    return [(number, vertices.tolist(), inside) for number, (vertices, inside) in sorted(objects.items())]


def held_plainly(receiver: Receiver) -> list[tuple[int, list[int], bool]]:
    held = receiver.held
    parts = np.split(symbols(held.polygons), held.polygons.start[1:-1])
    return list(
        zip(held.number.tolist(), [p.tolist() for p in parts], held.polygons.inside.tolist(), strict=False)
    )


@quick
@given(st.lists(nearly_right(), max_size=6), st.lists(st.integers(0, 2**20), max_size=6), st.booleans())
def test_whole_pieces_are_read_as_packet_by_packet(
    steps: list[list[Packet]], cuts: list[int], damage: bool
) -> None:
    receiver, draft, pending = Receiver(SHAPE), Draft(SHAPE), b""
    data = bytearray(b"".join(map(encode, [SQUARE, *steps])))
    if damage:
        data[cuts[0] % len(data) if cuts else -1] ^= 0x10
    for piece in pieces(bytes(data), cuts):
        attempt = deepcopy(draft)
        try:
            pending_then = attempt.read(pending, piece)
        except ProtocolError as error:
            with pytest.raises(ProtocolError) as caught:
                receiver.feed(piece)
            assert str(caught.value) == str(error)
        else:
            receiver.feed(piece)
            draft, pending = attempt, pending_then
        assert held_plainly(receiver) == plainly(draft.saved or {})


@quick
@given(
    st.lists(nearly_right(), max_size=6),
    st.lists(st.integers(0, 2**20), max_size=6),
    st.builds(Drawing, *2 * [st.booleans()]),
)
def test_what_has_not_changed_is_drawn_as_before(
    steps: list[list[Packet]], cuts: list[int], drawing: Drawing
) -> None:
    receiver = Receiver(SHAPE)
    drawn = layer(receiver.held.polygons, drawing)
    for piece in pieces(b"".join(map(encode, [SQUARE, *steps])), cuts):
        with suppress(ProtocolError):
            receiver.feed(piece)
        now = layer(receiver.held.polygons, drawing)
        draw_anew(drawn, receiver.objects, drawing, receiver.changed())
        assert drawn.tolist() == now.tolist()


def growth(rng: np.random.Generator, vertices: int, steps: int) -> list[Packet]:
    """Steps of which each inserts some vertices into the first object, which has so many before."""
    said: list[Packet] = []
    for _ in range(steps):
        more = int(rng.integers(1, 4))
        said.append(Change(0, vertices + more, 1))
        for _ in range(more):
            x, y, side = rng.integers((8, 6, 4)).tolist()
            said.append(Insert(int(rng.integers(vertices + 1)), x, y, side, int(rng.integers(2))))
            vertices += 1
        said.append(Save())
    return said


def test_those_who_read_together_hold_and_draw_what_each_would_alone() -> None:
    rng, once = np.random.default_rng(1), MemoCache()
    common = growth(rng, 4, 1)
    vertices = 4 + sum(isinstance(packet, Insert) for packet in common)
    stories = []
    for _ in range(20):
        alone, together = Receiver(SHAPE), Receiver(SHAPE, once)
        drawn = Drawn(SHAPE, THESIS, once)
        said = pieces(encode(growth(rng, vertices, 3)), rng.integers(2**20, size=3).tolist())
        for piece in [encode(SQUARE), encode(common), *said]:
            for receiver in (alone, together):
                receiver.feed(piece)
            assert held_plainly(together) == held_plainly(alone)
            drawn.follow(together.objects, together.changed())
            assert drawn.layer.tolist() == layer(alone.held.polygons).tolist()
            stories.append((together.objects, alone.held))
    for objects, held in stories:
        assert objects.polygons()[1].canonical() == held.polygons.canonical(), "nobody has written on it"


@quick
@given(growing_maps(), st.sampled_from([0, 1, 4, None]), st.builds(Drawing, *2 * [st.booleans()]))
def test_of_what_a_robot_tells_all_that_looks_different_has_changed(
    steps: list[tuple[np.ndarray, tuple[int, int]]], splits: int | None, drawing: Drawing
) -> None:
    receiver = Receiver(steps[0][0].shape)
    drawn = layer(receiver.held.polygons, drawing)
    for data, approximated in told(splits, steps):
        receiver.feed(data)
        draw_anew(drawn, receiver.objects, drawing, receiver.changed())
        assert drawn.tolist() == layer(approximated, drawing).tolist()


def test_of_a_real_story_little_is_drawn_anew_and_it_comes_to_the_same() -> None:
    receiver = Receiver(real_map("fr079").shape)
    drawn = layer(receiver.held.polygons)
    areas = []
    for data, approximated in real_story():
        receiver.feed(data)
        boxes = receiver.changed()
        draw_anew(drawn, receiver.objects, THESIS, boxes)
        assert (drawn == layer(approximated)).all()
        areas.append(int(((boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1])).sum()))
    assert np.median(areas) < drawn.size / 10
    assert not len(receiver.changed()), "it has been asked"


@pytest.mark.parametrize(
    ("packets", "reason"),
    [
        ([Insert(0, 1, 1, 0, 0)], "no object has been named that it speaks of"),
        ([Save()], "nothing has changed since the last one"),
        ([Emerge(0, 4, 1)], "object 0 is there already"),
        ([Change(1, 4, 1)], "there is no object 1"),
        ([Remove(3)], "there is no object 3"),
        ([Remove(0), Save()], "0 inside objects: there must be exactly one"),
        ([Emerge(1, 1, 0)], "1 vertices: an object has 2 to 4096"),
        ([Emerge(1, 4097, 0)], "4097 vertices: an object has 2 to 4096"),
        ([Change(0, 4, 1), Delete(4)], "index 4 of object 0: the last one is 3"),
        ([Change(0, 5, 1), Insert(5, 1, 1, 0, 0)], "index 5 of object 0: the last one is 4"),
        ([Change(0, 4, 1), Replace(0, 9, 1, 0, 0)], r"cell \(9, 1\) is outside the 8 x 6 grid"),
        ([Change(0, 4, 1), Delete(0), Save()], "object 0 has 3 vertices, not 4 as announced"),
        ([Emerge(1, 3, 0), Remove(0)], "object 1 has 0 vertices, not 3 as announced"),
        ([Target(1, 1)], "does not belong in a map's stream"),
    ],
)
def test_a_refusal_says_what_is_wrong(packets: list[Packet], reason: str) -> None:
    receiver = Receiver(SHAPE)
    receiver.feed(encode(SQUARE))
    before = state(receiver)
    with pytest.raises(ProtocolError, match=reason) as caught:
        receiver.feed(encode(packets))
    assert caught.value.offset == sum(packet.size for packet in packets[:-1])
    assert state(receiver) == before


def test_a_piece_that_fails_behind_a_save_point_is_refused_with_it() -> None:
    receiver = Receiver(SHAPE)
    receiver.feed(encode(SQUARE))
    before = state(receiver)
    with pytest.raises(ProtocolError):
        receiver.feed(encode([Change(0, 3, 1), Delete(0), Save(), Save()]))
    assert state(receiver) == before


def test_the_largest_objects_and_numbers_are_held() -> None:
    receiver = Receiver((2048, 2048))
    last = MAX_OBJECTS - 1
    receiver.feed(encode([Emerge(last, MAX_VERTICES, 1)]))
    receiver.feed(encode(Insert(i, i % 2049, 2048 - i % 7, i % 4, 1) for i in range(MAX_VERTICES)))
    with pytest.raises(ProtocolError, match="is full with 4096 vertices"):
        receiver.feed(encode([Insert(0, 0, 0, 0, 0)]))
    assert receiver.feed(encode([Save()]))
    assert receiver.held.number.tolist() == [last]
    assert receiver.held.polygons.x.tolist() == [i % 2049 for i in range(MAX_VERTICES)]
    assert receiver.held.polygons.y.tolist() == [2048 - i % 7 for i in range(MAX_VERTICES)]
