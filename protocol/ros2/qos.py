"""Quality of service: what a publisher or subscription offers, and its text in liveliness tokens.

The text is ``reliability:durability:history,depth:deadline:lifespan:liveliness``, the last three with seconds and
nanoseconds. A field that has its default is empty. The defaults are those of rmw_zenoh, whose depth is 42.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import IntEnum

from protocol.errors import ProtocolError, shown
from protocol.nanoseconds import SECOND

FOREVER_NS = 2**63 - 1
"""Nanoseconds of an infinite duration."""
TOKEN_DEPTH = 42
"""The depth that tokens leave out."""
MAX_DEPTH = 1 << 20


class Reliability(IntEnum):
    """Whether messages may be lost on a busy link."""

    RELIABLE = 1
    BEST_EFFORT = 2


class Durability(IntEnum):
    """Whether late subscriptions get the last messages."""

    TRANSIENT_LOCAL = 1
    VOLATILE = 2


class History(IntEnum):
    """How many messages a queue keeps: the last `Qos.depth`, or all."""

    KEEP_LAST = 1
    KEEP_ALL = 2


class Liveliness(IntEnum):
    """How an endpoint shows that it is alive; rmw_zenoh implements only the first way."""

    AUTOMATIC = 1
    MANUAL_BY_NODE = 2
    MANUAL_BY_TOPIC = 3


@dataclass(frozen=True)
class Qos:
    """A profile; its defaults are those of rclpy. Durations are nanoseconds."""

    reliability: Reliability = Reliability.RELIABLE
    durability: Durability = Durability.VOLATILE
    history: History = History.KEEP_LAST
    depth: int = 10
    deadline_ns: int = FOREVER_NS
    lifespan_ns: int = FOREVER_NS
    liveliness: Liveliness = Liveliness.AUTOMATIC
    lease_ns: int = FOREVER_NS

    def __post_init__(self) -> None:
        if not 1 <= self.depth <= MAX_DEPTH:
            raise ValueError(f"depth {self.depth} is not from 1 to {MAX_DEPTH}")
        for duration in (self.deadline_ns, self.lifespan_ns, self.lease_ns):
            if not 0 <= duration <= FOREVER_NS:
                raise ValueError(f"{duration} ns is not from 0 to {FOREVER_NS} ns (infinite)")

    @property
    def is_transient_local(self) -> bool:
        """Whether late subscriptions get the last messages."""
        return self.durability is Durability.TRANSIENT_LOCAL

    @property
    def kept(self) -> int | None:
        """Maximum number of messages in a queue; None for all."""
        return self.depth if self.history is History.KEEP_LAST else None

    def __str__(self) -> str:
        return ":".join(
            (
                _text(self.reliability, Reliability.RELIABLE),
                _text(self.durability, Durability.VOLATILE),
                f"{_text(self.history, History.KEEP_LAST)},{_text(self.depth, TOKEN_DEPTH)}",
                _duration(self.deadline_ns),
                _duration(self.lifespan_ns),
                f"{_text(self.liveliness, Liveliness.AUTOMATIC)},{_duration(self.lease_ns)}",
            )
        )


DEFAULT = Qos()
SENSOR = Qos(Reliability.BEST_EFFORT, depth=5)
"""For scans: the last ones count."""
LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
"""For maps: a subscription that joins later gets the last one."""
TF = Qos(depth=100)
TF_STATIC = Qos(durability=Durability.TRANSIENT_LOCAL, depth=100)
"""For a subscription to ``tf_static``: it has several publishers, each with its last message."""


def parse_qos(text: str) -> Qos:
    """Parse the text of a profile; ProtocolError says which field is wrong."""
    fields = text.split(":")
    if len(fields) != 6:
        raise _malformed(text, f"{len(fields)} fields between colons instead of 6")
    parts = [field.split(",") for field in fields]
    for name, part, count in zip(_FIELDS, parts, (1, 1, 2, 2, 2, 3), strict=True):
        if len(part) != count:
            raise _malformed(text, f"{name} has {len(part)} numbers between commas instead of {count}")
    (reliability,), (durability,), (history, depth), deadline, lifespan, (liveliness, *lease) = parts
    try:
        return Qos(
            Reliability(_number(reliability, Reliability.RELIABLE)),
            Durability(_number(durability, Durability.VOLATILE)),
            History(_number(history, History.KEEP_LAST)),
            _number(depth, TOKEN_DEPTH),
            _nanoseconds(deadline),
            _nanoseconds(lifespan),
            Liveliness(_number(liveliness, Liveliness.AUTOMATIC)),
            _nanoseconds(lease),
        )
    except ValueError as error:
        raise _malformed(text, str(error)) from None


_FIELDS = ("reliability", "durability", "history", "deadline", "lifespan", "liveliness")


def _text(value: int, default: int) -> str:
    return "" if value == default else str(int(value))


def _duration(nanoseconds: int) -> str:
    """Return seconds and nanoseconds; each is left out if it is the one of an infinite duration."""
    pairs = zip(divmod(nanoseconds, SECOND), divmod(FOREVER_NS, SECOND), strict=True)
    return ",".join(_text(value, default) for value, default in pairs)


def _number(text: str, default: int) -> int:
    if not text:
        return default
    if not re.fullmatch("[0-9]{1,19}", text):
        raise ValueError(f"{shown(text)} is not a number")
    return int(text)


def _nanoseconds(parts: list[str]) -> int:
    seconds, rest = map(_number, parts, divmod(FOREVER_NS, SECOND))
    return seconds * SECOND + rest


def _malformed(text: str, reason: str) -> ProtocolError:
    return ProtocolError("ROS 2 quality of service", 0, f"{reason}, in {shown(text)}")
