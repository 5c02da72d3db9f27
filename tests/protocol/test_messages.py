"""Messages: all of them round trip, and nothing is read that is not one."""

from __future__ import annotations

from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from protocol import messages
from protocol.errors import ProtocolError
from protocol.messages import (
    Begin,
    End,
    Move,
    Said,
    Sense,
    cells_from_bytes,
    cells_to_bytes,
    pack,
    unpack,
    unpack_as,
)

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
VALUES: dict[str, st.SearchStrategy[Any]] = {
    "int": whole,
    "bool": st.booleans(),
    "str": st.text(),
    "bytes": st.binary(),
    "list[int]": st.lists(whole, max_size=5),
    "dict[str, Any]": st.dictionaries(st.text(), trees, max_size=4),
}
said = st.sampled_from(KINDS).flatmap(
    lambda kind: st.builds(
        kind, **{name: VALUES[kinds_of] for name, kinds_of in kind.__annotations__.items()}
    )
)


def test_every_message_is_known() -> None:
    assert len(KINDS) == 24
    assert all(type(unpack(pack(kind(*map(_some, kind.__annotations__.values()))))) is kind for kind in KINDS)


def _some(annotation: str) -> Any:
    return {"int": 1, "bool": True, "str": "a", "bytes": b"b", "list[int]": [1]}.get(annotation, {"a": 1})


@given(said)
def test_what_is_written_is_read(message: Any) -> None:
    assert unpack(pack(message)) == message
    assert unpack_as(type(message), pack(message)) == message


@given(said)
def test_a_message_is_a_msgpack_list_of_its_number_and_its_fields(message: Any) -> None:
    kind = type(message)
    items = [KINDS_IN_ORDER.index(kind), *(getattr(message, name) for name in kind.__annotations__)]
    assert pack(message) == msgpack.packb(items)
    assert unpack(msgpack.packb(items)) == message


@given(said, st.data())
def test_a_field_of_a_wrong_type_is_refused_by_name(message: Any, data: st.DataObject) -> None:
    items = msgpack.unpackb(pack(message))
    if len(items) == 1:
        return
    at = data.draw(st.integers(1, len(items) - 1))
    right, annotation = list(type(message).__annotations__.items())[at - 1]
    wrong = data.draw(
        st.sampled_from([name for name in VALUES if name != annotation]).flatmap(VALUES.__getitem__)
    )
    if annotation == "list[int]" and wrong == []:
        return
    items[at] = wrong
    with pytest.raises(ProtocolError, match=f"{type(message).__name__} at byte 0: {right} must be"):
        unpack(msgpack.packb(items))


@given(said, st.integers(-3, 3))
def test_a_message_with_fields_missing_or_to_spare_is_refused(message: Any, more: int) -> None:
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
def test_what_does_not_begin_with_the_number_of_a_message_is_none(nothing: object) -> None:
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


@given(said, st.data())
def test_a_message_cut_off_or_followed_by_more_is_refused(message: Any, data: st.DataObject) -> None:
    payload = pack(message)
    cut = data.draw(st.integers(0, len(payload) - 1))
    for broken in (payload[:cut], payload + b"\x00"):
        with pytest.raises(ProtocolError, match="not msgpack"):
            unpack(broken)


def test_numbers_beyond_a_field_are_no_numbers_at_all() -> None:
    sense = Sense(1, 2, 3, 4, b"", b"", "")
    with pytest.raises(ProtocolError, match="x must be int, not True"):
        unpack(pack(Sense(1, True, 3, 4, b"", b"", "")))
    assert unpack(pack(sense)) == sense


def test_a_list_of_anything_but_whole_numbers_is_refused() -> None:
    for wrong in ([1, True], [1.0], [None], ["1"]):
        with pytest.raises(ProtocolError, match=r"connections must be list\[int\]"):
            unpack(pack(Said(1, 0, "offers", wrong)))  # type: ignore[arg-type]


def test_a_message_of_another_kind_is_refused_where_one_is_expected() -> None:
    with pytest.raises(ProtocolError, match="Begin at byte 0: expected End here"):
        unpack_as(End, pack(Begin()))


@given(st.lists(st.tuples(st.integers(-(2**15), 2**15 - 1), st.integers(-(2**15), 2**15 - 1)), max_size=20))
def test_cells_round_trip(cells: list[tuple[int, int]]) -> None:
    array = np.array(cells, np.int32).reshape(-1, 2)
    data = cells_to_bytes(array)
    assert len(data) == 4 * len(cells)
    read = cells_from_bytes(data)
    assert read.dtype == np.int32
    assert read.tolist() == array.tolist()


@pytest.mark.parametrize("size", [1, 2, 3, 5])
def test_cells_that_are_no_pairs_are_refused(size: int) -> None:
    with pytest.raises(ProtocolError, match=f"{size} bytes are not pairs"):
        cells_from_bytes(bytes(size))


def test_cells_are_little_endian_pairs() -> None:
    assert cells_to_bytes(np.array([[1, -2], [258, 3]], np.int32)).hex() == "0100feff02010300"


def test_a_long_value_is_shortened_in_the_complaint() -> None:
    with pytest.raises(ProtocolError) as caught:
        unpack(pack(Move(1, "a" * 10_000, 0, explored=False)))  # type: ignore[arg-type]
    assert len(str(caught.value)) < 120
