"""The receiving end: cut streams, hostile streams, and that only a save point counts."""

from __future__ import annotations

from contextlib import suppress
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.memo_cache import MemoCache
from agent.outline.approximation import approximation, repair
from agent.outline.claims import THESIS, Drawing, DrawnClaims, redraw
from agent.outline.contour import contours
from agent.outline.edits import NumberedPolygons
from agent.outline.merge import rendered
from agent.outline.polygons import Polygons
from agent.outline.receiver import Receiver
from agent.outline.simplify import refine
from protocol.errors import ProtocolError
from protocol.packet_codec import encode
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
)
from tests.agent.explorations import exploration, growing_maps, real_map
from tests.agent.outline.edit_scripts import canonical, edit_script, layer

quick = settings(deadline=None)

SHAPE = (6, 8)
SQUARE = [Emerge(0, 4, 1), *(Insert(i, i, 1, 0, 0) for i in range(4)), Save()]


def encoded_steps(
    splits: int | None, steps: list[tuple[np.ndarray, tuple[int, int]]]
) -> list[tuple[bytes, Polygons]]:
    """The packets of a robot in each step, and the approximation that they encode."""
    held = NumberedPolygons.empty(steps[0][0].shape)
    stream = []
    for grid, robot in steps:
        exact = contours(grid, robot)
        coarse = approximation(exact, refine(exact, repair(held.polygons, exact), splits))
        packets, held = edit_script(held, coarse)
        all_kinds: list[Packet] = list(packets)
        stream.append((encode(all_kinds), coarse))
    return stream


@cache
def real_stream() -> list[tuple[bytes, Polygons]]:
    return encoded_steps(3, list(exploration(real_map("fr079"), np.random.default_rng(6), 60, 60.0)))


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


def test_packets_behind_a_save_point_in_the_same_chunk_have_no_effect_yet() -> None:
    receiver = Receiver(SHAPE)
    pair = [Emerge(1, 2, 0), *(Insert(i, 3 + i, 3, 0, 0) for i in range(2))]
    receiver.feed(encode([*SQUARE[:-1], *pair, Save()]))
    assert state(receiver)[0] == [0, 1]
    receiver.feed(encode([Change(0, 3, 1), Delete(0), Save(), Remove(1)]))
    assert state(receiver)[0] == [0, 1]
    receiver.feed(encode([Save()]))
    assert state(receiver)[0] == [0]


def chunks(data: bytes, cuts: list[int]) -> list[bytes]:
    edges = [0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]
    return [data[a:b] for a, b in pairwise(edges)]


@quick
@given(growing_maps(), st.sampled_from([0, 2, None]))
def test_at_every_save_point_the_receiver_holds_the_senders_approximation(
    steps: list[tuple[np.ndarray, tuple[int, int]]], splits: int | None
) -> None:
    receiver = Receiver(steps[0][0].shape)
    for data, approximated in encoded_steps(splits, steps):
        assert receiver.feed(data) == bool(data)
        assert canonical(receiver.held.polygons) == canonical(approximated)


@quick
@given(growing_maps(), st.lists(st.integers(0, 2**20), max_size=12))
def test_a_stream_that_is_cut_anywhere_ends_in_the_same_state(
    steps: list[tuple[np.ndarray, tuple[int, int]]], cuts: list[int]
) -> None:
    stream = encoded_steps(1, steps)
    receiver = Receiver(steps[0][0].shape)
    for chunk in chunks(b"".join(data for data, _ in stream), cuts):
        receiver.feed(chunk)
    assert canonical(receiver.held.polygons) == canonical(stream[-1][1])


def test_a_real_stream_byte_by_byte_yields_only_saved_states() -> None:
    receiver = Receiver(real_map("fr079").shape)
    nothing = receiver.held
    for data, approximated in real_stream():
        before = receiver.held
        saves = [receiver.feed(data[i : i + 1]) or receiver.held is not before for i in range(len(data))]
        assert not any(saves[:-1]), "a half-sent step is never shown"
        assert canonical(receiver.held.polygons) == canonical(approximated)
    assert receiver.held is not nothing


@quick
@given(st.binary(max_size=200), st.lists(st.integers(0, 2**20), max_size=4))
def test_random_bytes_never_change_a_saved_state(noise: bytes, cuts: list[int]) -> None:
    receiver = Receiver(SHAPE)
    receiver.feed(encode(SQUARE))
    for chunk in chunks(noise, cuts):
        before = state(receiver)
        try:
            saved = receiver.feed(chunk)
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
def test_inconsistent_packets_never_change_a_saved_state(streams: list[list[Packet]]) -> None:
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
def test_an_edited_script_is_applied_as_a_whole_or_not_at_all(packets: list[Packet]) -> None:
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
def test_after_a_damaged_chunk_the_intact_one_is_accepted(step: int, data: st.DataObject) -> None:
    stream = real_stream()
    shape = real_map("fr079").shape
    receiver = Receiver(shape)
    for chunk, _ in stream[:step]:
        receiver.feed(chunk)
    begun = data.draw(st.integers(0, len(stream[step][0])))
    receiver.feed(stream[step][0][:begun])
    rest = stream[step][0][begun:]
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
        assert canonical(receiver.held.polygons) == canonical(stream[step][1])
    assert_well_formed(receiver, shape)


def held_plainly(receiver: Receiver) -> list[tuple[int, list[int], bool]]:
    held = receiver.held
    parts = np.split(held.polygons.symbols, held.polygons.start[1:-1])
    return list(
        zip(held.number.tolist(), [p.tolist() for p in parts], held.polygons.inside.tolist(), strict=False)
    )


@quick
@given(st.lists(nearly_right(), max_size=6), st.lists(st.integers(0, 2**20), max_size=6), st.booleans())
def test_chunks_are_read_like_single_bytes(steps: list[list[Packet]], cuts: list[int], damage: bool) -> None:
    receiver, accepted = Receiver(SHAPE), b""
    data = bytearray(b"".join(map(encode, [SQUARE, *steps])))
    if damage:
        data[cuts[0] % len(data) if cuts else -1] ^= 0x10
    for chunk in chunks(bytes(data), cuts):
        single = Receiver(SHAPE)
        for byte in accepted:
            single.feed(bytes([byte]))
        try:
            for byte in chunk:
                single.feed(bytes([byte]))
        except ProtocolError as error:
            with pytest.raises(ProtocolError) as caught:
                receiver.feed(chunk)
            assert (caught.value.packet, caught.value.reason) == (error.packet, error.reason)
        else:
            receiver.feed(chunk)
            accepted += chunk
            assert held_plainly(receiver) == held_plainly(single)


@quick
@given(
    st.lists(nearly_right(), max_size=6),
    st.lists(st.integers(0, 2**20), max_size=6),
    st.builds(Drawing, *2 * [st.booleans()]),
)
def test_cells_outside_the_changed_boxes_are_drawn_as_before(
    steps: list[list[Packet]], cuts: list[int], drawing: Drawing
) -> None:
    receiver = Receiver(SHAPE)
    drawn = layer(receiver.held.polygons, drawing)
    for chunk in chunks(b"".join(map(encode, [SQUARE, *steps])), cuts):
        with suppress(ProtocolError):
            receiver.feed(chunk)
        now = layer(receiver.held.polygons, drawing)
        redraw(drawn, receiver.objects, drawing, receiver.changed())
        assert drawn.tolist() == now.tolist()


def growth(rng: np.random.Generator, vertices: int, steps: int) -> list[Packet]:
    """Steps of which each inserts some vertices into the first object, which has so many before."""
    stream: list[Packet] = []
    for _ in range(steps):
        more = int(rng.integers(1, 4))
        stream.append(Change(0, vertices + more, 1))
        for _ in range(more):
            x, y, side = rng.integers((8, 6, 4)).tolist()
            stream.append(Insert(int(rng.integers(vertices + 1)), x, y, side, int(rng.integers(2))))
            vertices += 1
        stream.append(Save())
    return stream


def test_receivers_with_a_shared_cache_equal_separate_ones() -> None:
    rng, once = np.random.default_rng(1), MemoCache()
    common = growth(rng, 4, 1)
    vertices = 4 + sum(isinstance(packet, Insert) for packet in common)
    stories = []
    for _ in range(20):
        alone, together = Receiver(SHAPE), Receiver(SHAPE, once)
        drawn = DrawnClaims(SHAPE, THESIS, once)
        stream = chunks(encode(growth(rng, vertices, 3)), rng.integers(2**20, size=3).tolist())
        for chunk in [encode(SQUARE), encode(common), *stream]:
            for receiver in (alone, together):
                receiver.feed(chunk)
            assert held_plainly(together) == held_plainly(alone)
            drawn.update(together.objects, together.changed())
            assert drawn.layer.tolist() == layer(alone.held.polygons).tolist()
            stories.append((together.objects, alone.held))
    for objects, held in stories:
        assert canonical(objects.polygons()[1]) == canonical(held.polygons), (
            "the shared objects are not modified"
        )


@quick
@given(growing_maps(), st.sampled_from([0, 1, 4, None]), st.builds(Drawing, *2 * [st.booleans()]))
def test_the_changed_boxes_contain_all_cells_drawn_differently(
    steps: list[tuple[np.ndarray, tuple[int, int]]], splits: int | None, drawing: Drawing
) -> None:
    receiver = Receiver(steps[0][0].shape)
    drawn = layer(receiver.held.polygons, drawing)
    for data, approximated in encoded_steps(splits, steps):
        receiver.feed(data)
        redraw(drawn, receiver.objects, drawing, receiver.changed())
        assert drawn.tolist() == layer(approximated, drawing).tolist()


def test_a_real_stream_redraws_few_cells_with_the_same_result() -> None:
    receiver = Receiver(real_map("fr079").shape)
    drawn = layer(receiver.held.polygons)
    areas = []
    for data, approximated in real_stream():
        receiver.feed(data)
        boxes = receiver.changed()
        redraw(drawn, receiver.objects, THESIS, boxes)
        assert (drawn == layer(approximated)).all()
        areas.append(int(((boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1])).sum()))
    assert np.median(areas) < drawn.size / 10
    assert not len(receiver.changed()), "it has been asked"


@pytest.mark.parametrize(
    ("packets", "reason"),
    [
        ([Insert(0, 1, 1, 0, 0)], "no object is being edited"),
        ([Save()], "nothing has changed since the last save point"),
        ([Emerge(0, 4, 1)], "object 0 already exists"),
        ([Change(1, 4, 1)], "there is no object 1"),
        ([Remove(3)], "there is no object 3"),
        ([Remove(0), Save()], "0 inside objects: there must be exactly one"),
        ([Emerge(1, 1, 0)], "1 vertices: an object has 2 to 4096"),
        ([Emerge(1, 4097, 0)], "4097 vertices: an object has 2 to 4096"),
        ([Change(0, 4, 1), Delete(4)], "index 4 of object 0: the last one is 3"),
        ([Change(0, 5, 1), Insert(5, 1, 1, 0, 0)], "index 5 of object 0: the last one is 4"),
        ([Change(0, 4, 1), Replace(0, 9, 1, 0, 0)], r"cell \(9, 1\) is outside the 8 x 6 grid"),
        ([Change(0, 4, 1), Delete(0), Save()], "object 0 has 3 vertices instead of the announced 4"),
        ([Emerge(1, 3, 0), Remove(0)], "object 1 has 0 vertices instead of the announced 3"),
        ([Target(1, 1)], "edit streams have no packets of this kind"),
    ],
)
def test_the_error_of_a_malformed_stream_has_the_reason(packets: list[Packet], reason: str) -> None:
    receiver = Receiver(SHAPE)
    receiver.feed(encode(SQUARE))
    before = state(receiver)
    with pytest.raises(ProtocolError, match=reason) as caught:
        receiver.feed(encode(packets))
    assert caught.value.offset == sum(packet.size for packet in packets[:-1])
    assert state(receiver) == before


def test_a_chunk_that_fails_behind_a_save_point_is_rejected_as_a_whole() -> None:
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
