"""Messages: all of them round trip, and the decoder rejects all other bytes."""

from __future__ import annotations

from typing import Any

import msgpack
import msgspec
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from msgspec import inspect

from protocol import message_codec, messages
from protocol.cell_bytes import cells_from_bytes, cells_to_bytes
from protocol.errors import ProtocolError
from protocol.message_codec import pack, unpack
from protocol.messages import Begin, End, Move, OutgoingFrame, RobotFrames, Sense

KINDS = [
    kind
    for kind in vars(messages).values()
    if isinstance(kind, type) and issubclass(kind, messages.Record) and kind is not messages.Record
]
KINDS_IN_ORDER = sorted(KINDS, key=lambda kind: kind.__struct_config__.tag)

whole = st.integers(-(2**63), 2**64 - 1)
plain = st.none() | st.booleans() | whole | st.floats(allow_nan=False) | st.text() | st.binary()
trees = st.recursive(
    plain, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4)
)


def fields_of(kind: type[messages.Record]) -> dict[str, inspect.Type]:
    record = inspect.type_info(kind)
    assert isinstance(record, inspect.StructType)
    return {field.name: field.type for field in record.fields}


def values(kind: inspect.Type) -> st.SearchStrategy[Any]:
    """Values of a field; lengths up to 5, and the maximum."""
    match kind:
        case inspect.IntType():
            assert kind.ge is not None
            least, most = kind.ge, kind.le if kind.le is not None else (kind.lt or 0) - 1
            return st.integers(least, most) | st.sampled_from([least, most])
        case inspect.BoolType():
            return st.booleans()
        case inspect.StrType():
            return st.text(max_size=min(kind.max_length or 0, 5))
        case inspect.BytesType():
            return st.binary(max_size=5)
        case inspect.ListType():
            return st.lists(values(kind.item_type), max_size=min(kind.max_length or 0, 5))
        case inspect.NoneType():
            return st.none()
        case inspect.UnionType(types=kinds):
            return st.one_of(map(values, kinds))
        case inspect.StructType(cls=cls) if issubclass(cls, messages.Record):
            return a_message(cls)
        case inspect.StructType(cls=cls, fields=parts):
            return st.builds(cls, **{part.name: values(part.type) for part in parts})
    return st.dictionaries(st.text(), trees, max_size=4)


@st.composite
def a_message(draw: st.DrawFn, *kinds: type[messages.Record]) -> messages.Record:
    """Any message, or one of these kinds; of arrays that belong together, as many of each, in whole rows."""
    kind = draw(st.sampled_from(kinds or KINDS))
    drawn = {name: draw(values(of)) for name, of in fields_of(kind).items()}
    lists = TOGETHER.get(kind, ())
    for name in lists:
        drawn[name] = (drawn[name] + [0] * 5)[: len(drawn[lists[0]])]
    for name, row in ROWS.get(kind, {}).items():
        drawn[name] = row * drawn[name]
    if kind is messages.MapChanges:
        drawn["cells"] = 4 * drawn["values"]
    return kind(**drawn)


TOGETHER: dict[type[messages.Record], tuple[str, ...]] = {
    messages.Positions: ("robots", "x", "y"),
}
ROWS: dict[type[messages.Record], dict[str, int]] = {
    messages.Sense: {"driven": 4, "readings": 2},
    messages.Move: {"path": 4, "points": 8},
    messages.WorldReport: {"poses": 16, "people": 8},
    messages.Outlines: {"vertices": 8},
}
any_message = a_message()


def test_every_message_is_known() -> None:
    assert len(KINDS) == 31
    assert [kind.__struct_config__.tag for kind in KINDS_IN_ORDER] == list(range(31))


@given(any_message)
def test_decoding_inverts_encoding(message: Any) -> None:
    assert unpack(pack(message)) == message


@given(any_message)
def test_a_message_is_a_msgpack_list_of_its_number_and_its_fields(message: Any) -> None:
    kind = type(message)
    fields = (getattr(message, name) for name in kind.__annotations__)
    items = [
        KINDS_IN_ORDER.index(kind),
        *(msgspec.to_builtins(each, builtin_types=[bytes]) for each in fields),
    ]
    assert pack(message) == msgpack.packb(items)
    assert unpack(msgpack.packb(items)) == message


@given(any_message, st.data())
def test_a_field_of_a_wrong_type_or_out_of_its_range_is_refused_by_name(
    message: Any, data: st.DataObject
) -> None:
    items = msgpack.unpackb(pack(message))
    if len(items) == 1:
        return
    at = data.draw(st.integers(1, len(items) - 1))
    right, of = list(fields_of(type(message)).items())[at - 1]
    items[at] = data.draw(wrong_for(of))
    with pytest.raises(ProtocolError, match=rf"{type(message).__name__} at byte 0: {right}(\[|:)"):
        unpack(msgpack.packb(items))


def wrong_for(kind: inspect.Type) -> st.SearchStrategy[Any]:
    match kind:
        case inspect.IntType():
            assert kind.ge is not None
            most = kind.le if kind.le is not None else (kind.lt or 0) - 1
            return st.sampled_from(
                [kind.ge - 1, most + 1, 2**64 - 1, -(2**63), True, None, 1.5, "1", b"1", [1]]
            )
        case inspect.BoolType():
            return st.sampled_from([0, 1, None, "true"])
        case inspect.StrType():
            return st.sampled_from([1, None, b"a", [], "a" * ((kind.max_length or 0) + 1)])
        case inspect.BytesType() if (kind.max_length or 0) < message_codec.MAX_EXPLAINED // 2:
            return st.sampled_from([1, None, "a", [], bytes((kind.max_length or 0) + 1)])
        case inspect.BytesType():
            return st.sampled_from([1, None, "a", []])
        case inspect.ListType():
            too_many = [0] * ((kind.max_length or 0) + 1)
            return st.sampled_from([1, None, b"a", [True], [1.5], [-2], [None], {}, too_many])
        case inspect.UnionType(types=kinds) if any(isinstance(each, inspect.NoneType) for each in kinds):
            return st.sampled_from([-1, "a", b"a", [], [-1], 1.5])
    return st.sampled_from([1, None, "a", []])


@pytest.mark.parametrize("kind", KINDS)
def test_no_message_is_longer_than_its_kind_may_be(kind: type[messages.Record]) -> None:
    most = message_codec.max_bytes(inspect.type_info(kind))
    assert most < 1 << 32
    read = message_codec.unpacker((kind,), "r1")
    if most < 1 << 24:
        with pytest.raises(ProtocolError, match=f"{most + 1} bytes; r1 may send at most {most}"):
            read(bytes(most + 1))


def test_fields_that_do_not_fit_together_are_refused() -> None:
    with pytest.raises(ProtocolError, match="different lengths"):
        unpack(msgpack.packb([4, 1, [0, 1], [2], [2]]))
    for items in (
        [3, 1, b"abc", 0, True, True, False, b""],
        [14, 1, bytes(15), [], 1, 1, b""],
        [14, 1, b"", [], 1, 1, bytes(7)],
        [21, 1, 0, bytes(5)],
        [26, 1, bytes(5), bytes(1)],
    ):
        with pytest.raises(ProtocolError, match="bytes"):
            unpack(msgpack.packb(items))
    with pytest.raises(ProtocolError, match=r"events\[0\]\[4\]\[0\]: Expected `array` of at least length 2"):
        unpack(msgpack.packb([25, [[6, 1, 0, "offers", [[0]]]]]))
    with pytest.raises(ProtocolError, match="part: Expected `int` <= 7"):
        unpack(msgpack.packb([17, 8, bytes(5)]))


@given(any_message, st.integers(-3, 3))
def test_a_message_with_missing_or_additional_fields_is_refused(message: Any, more: int) -> None:
    items = msgpack.unpackb(pack(message))
    changed = [*items, *more * [0]] if more > 0 else items[: max(len(items) + more, 1)]
    if len(changed) != len(items):
        with pytest.raises(ProtocolError, match=f"{len(changed) - 1} fields instead of {len(items) - 1}"):
            unpack(msgpack.packb(changed))


@pytest.mark.parametrize(
    "nothing",
    [
        None,
        1,
        "a",
        b"a",
        {},
        [],
        [-1],
        [len(KINDS)],
        [None],
        ["0"],
        [[]],
        [{}],
        [True],
        [False],
        [0.0],
        [1.5],
    ],
    ids=repr,
)
def test_bytes_without_a_message_number_are_refused(nothing: object) -> None:
    with pytest.raises(ProtocolError, match="number of a message"):
        unpack(msgpack.packb(nothing))


@given(trees | st.lists(trees | st.integers(0, 20), max_size=9))
def test_random_msgpack_is_a_message_or_a_protocol_error(tree: Any) -> None:
    try:
        message = unpack(msgpack.packb(tree))
    except ProtocolError:
        return
    assert type(message) in KINDS


@given(st.binary(max_size=300))
@example(b"\x91\xca\x00\x00\x00\x00")
@example(b"\x81\x80\x00")
@example(b"\xc7\x0c\xff" + bytes([0xFF] * 12))
@example(b"\xd6\xff\x00\x00\x00\x00")
@example(1100 * b"\x91")
@example(b"\xdd\xff\xff\xff\xff")
def test_random_bytes_are_a_message_or_a_protocol_error(noise: bytes) -> None:
    try:
        message = unpack(noise)
    except ProtocolError:
        return
    assert type(message) in KINDS


@given(any_message, st.data())
def test_a_message_cut_off_or_followed_by_more_is_refused(message: Any, data: st.DataObject) -> None:
    payload = pack(message)
    cut = data.draw(st.integers(0, len(payload) - 1))
    for broken in (payload[:cut], payload + b"\x00"):
        with pytest.raises(ProtocolError, match="not msgpack"):
            unpack(broken)


def test_numbers_beyond_a_field_are_refused() -> None:
    sense = Sense(1, 2, 3, 4, b"", b"", "")
    with pytest.raises(ProtocolError, match="x: Expected `int`, got `bool`"):
        unpack(pack(Sense(1, True, 3, 4, b"", b"", "")))
    assert unpack(pack(sense)) == sense


def test_a_list_of_other_items_than_frames_is_refused() -> None:
    for wrong in ([1], [b"frame"], [OutgoingFrame(1.0, b"")], [OutgoingFrame(1, "text")], [None]):  # type: ignore[arg-type]
        with pytest.raises(ProtocolError, match=r"frames\[0\]"):
            unpack(pack(RobotFrames(1, 0, "offers", b"", wrong)))  # type: ignore[arg-type]


def test_a_message_of_an_unexpected_kind_is_refused() -> None:
    with pytest.raises(ProtocolError, match="Begin at byte 0: r1 may not send it here"):
        message_codec.unpacker((End,), "r1")(pack(Begin()))


@given(st.lists(st.tuples(st.integers(-(2**15), 2**15 - 1), st.integers(-(2**15), 2**15 - 1)), max_size=20))
def test_cells_round_trip(cells: list[tuple[int, int]]) -> None:
    array = np.array(cells, np.int32).reshape(-1, 2)
    data = cells_to_bytes(array)
    assert len(data) == 4 * len(cells)
    read = cells_from_bytes(data)
    assert read.dtype == np.int32
    assert read.tolist() == array.tolist()


@pytest.mark.parametrize("size", [1, 2, 3, 5])
def test_bytes_that_are_not_pairs_of_cells_are_refused(size: int) -> None:
    whole = pack(Move(1, b"cell", 0, explored=False))
    with pytest.raises(ProtocolError, match=f"{size} and 0 bytes are not pairs"):
        unpack(whole.replace(b"\xc4\x04cell", bytes([0xC4, size]) + bytes(size)))


def test_cells_are_little_endian_pairs() -> None:
    assert cells_to_bytes(np.array([[1, -2], [258, 3]], np.int32)).hex() == "0100feff02010300"


def test_a_long_value_is_shortened_in_the_error_text() -> None:
    with pytest.raises(ProtocolError) as caught:
        unpack(pack(Move(1, "a" * 10_000, 0, explored=False)))  # type: ignore[arg-type]
    assert len(str(caught.value)) < 150
