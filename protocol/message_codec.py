"""Encode and decode messages of the bus: msgpack, checked against the types of their fields (`protocol.messages`)."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from typing import Any, Union

import msgspec
from msgspec import inspect

from protocol.errors import ProtocolError
from protocol.message_fields import MAX_FRAME, MAX_FRAMES, MAX_PAYLOAD
from protocol.messages import TYPES, Record

_HEAD = {kind: 0x90 | len(kind.__struct_fields__) + 1 for kind in TYPES}
"""First byte of each message: the msgpack head of a list with this number of items."""

_NOT_DECODED = msgspec.DecodeError, RecursionError, UnicodeDecodeError

pack: Callable[[Record], bytes] = msgspec.msgpack.Encoder().encode
"""Write a message."""


def unpacker(
    kinds: tuple[type[Record], ...], sender: str, limit: int = MAX_PAYLOAD
) -> Callable[[bytes], Any]:
    """Return a decoder of the messages that `sender` may send; it rejects all others with ProtocolError.

    It rejects a payload that is longer than `limit`, or than the longest of these messages, before it decodes it.
    """
    if not kinds:
        return partial(_refuse_all, sender)
    read: Callable[[bytes], Any] = msgspec.msgpack.Decoder(Union[kinds]).decode  # noqa: UP007  a union of a tuple
    most = min(limit, max(max_bytes(inspect.type_info(kind)) for kind in kinds))

    def unpack_one(payload: bytes) -> Any:
        if len(payload) > most:
            raise ProtocolError("message", 0, f"{len(payload)} bytes; {sender} may send at most {most}")
        try:
            message = read(payload)
        except _NOT_DECODED as error:
            raise _malformed(payload, kinds, sender, str(error)) from None
        # Fields with a default must be present as well.
        if payload[0] != _HEAD[type(message)]:
            raise _malformed(payload, kinds, sender, "its list has not the shortest form of msgpack")
        return message

    return unpack_one


MAX_EXPLAINED = 1 << 16
"""Maximum bytes of a malformed message that is decoded again, to name the field that is wrong."""
HEAD_BYTES = 9
"""Maximum size of a number, or of a length field, in msgpack."""


def max_bytes(kind: inspect.Type) -> int:
    """Bytes of the longest message of a kind: its fields at their maximum, each with the longest head of msgpack."""
    match kind:
        case inspect.BytesType(max_length=int(most)):
            return HEAD_BYTES + most
        case inspect.StrType(max_length=int(most)):
            return HEAD_BYTES + 4 * most
        case inspect.ListType(item_type=item, max_length=int(most)):
            frames = _frames_in(item)
            item_bytes = max_bytes(item) - frames * MAX_FRAME
            return HEAD_BYTES + most * item_bytes + (MAX_FRAMES if frames else 0)
        case inspect.UnionType(types=kinds):
            return max(map(max_bytes, kinds))
        case inspect.StructType(fields=parts):
            return HEAD_BYTES + sum(max_bytes(part.type) for part in parts)
        case inspect.IntType() | inspect.BoolType() | inspect.NoneType():
            return HEAD_BYTES
    raise TypeError(f"{kind} has no maximum size")


def _frames_in(kind: inspect.Type) -> int:
    """Count the frames in an item of a list; all frames of a list have at most `MAX_FRAMES` bytes."""
    match kind:
        case inspect.BytesType(max_length=most):
            return int(most == MAX_FRAME)
        case inspect.StructType(fields=parts):
            return sum(_frames_in(part.type) for part in parts)
    return 0


unpack = unpacker(TYPES, "a participant")
"""Decode a message of any kind, from any sender; ProtocolError if it is malformed."""


def _refuse_all(sender: str, _: bytes) -> Any:
    raise ProtocolError("message", 0, f"{sender} may send no message here")


def _malformed(payload: bytes, kinds: tuple[type[Record], ...], sender: str, reason: str) -> ProtocolError:
    """Return the error of a malformed message; it names the field to which the path in msgspec's `reason` leads."""
    if len(payload) > MAX_EXPLAINED:
        return ProtocolError("message", 0, f"{len(payload)} malformed bytes: {reason}")
    try:
        items = msgspec.msgpack.decode(payload)
    except _NOT_DECODED as error:
        return ProtocolError("message", 0, f"not msgpack ({error})")
    number = items[0] if isinstance(items, list) and items else None
    if type(number) is not int or not 0 <= number < len(TYPES):
        return ProtocolError("message", 0, "not a list that begins with the number of a message")
    kind = TYPES[number]
    if kind not in kinds:
        return ProtocolError(kind.__name__, 0, f"{sender} may not send it here")
    fields = kind.__struct_fields__
    if len(items) != len(fields) + 1:
        return ProtocolError(kind.__name__, 0, f"{len(items) - 1} fields instead of {len(fields)}")
    if path := re.search(r" - at `\$\[(\d+)\](.*)`$", reason):
        reason = f"{fields[int(path[1]) - 1]}{path[2]}: {reason[: path.start()]}"
    return ProtocolError(kind.__name__, 0, reason)
