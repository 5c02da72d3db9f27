"""Types of scenario values, and tables of a scenario: ``[[fault]]`` and ``[[change]]``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import is_dataclass
from typing import Annotated, Any, Literal, Self, get_args, get_origin, get_type_hints

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from netshaper.radio_options import MIN_FRAME
from protocol.budget import WORD_FOR_UNLIMITED
from protocol.errors import shown
from protocol.faults import KINDS, TEMPORARY, Kind
from protocol.messages import FaultEvent

MAX_TOLERANCE = 4
"""Largest tolerance of shared maps, in cells."""

MAX_INTEGER = 2**31 - 1
"""Largest integer that the columns of the ledger can hold."""

MAX_METERS = 1e6

MAX_RUNS = 100_000
"""Maximum number of runs, and of seeds, of a study."""

Whole = Annotated[int, Field(strict=True)]
Meters = Annotated[float, Field(strict=True, ge=-MAX_METERS, le=MAX_METERS)]
Positive = Annotated[float, Field(strict=True, gt=0, le=MAX_METERS)]
NotNegative = Annotated[float, Field(strict=True, ge=0, le=MAX_METERS)]
LimitOrNone = Annotated[int | None, Field(strict=True, ge=MIN_FRAME, le=MAX_INTEGER)]
Degrees = Annotated[float, Field(strict=True, le=360)]


def range_in_meters(text: str, diagonal_m: float) -> float:
    """Return a communication range in meters; a share refers to the map's diagonal. ValueError if it is invalid."""
    try:
        number = float(text.strip().removesuffix("%"))
    except ValueError:
        number = math.nan
    if not 0 <= number <= MAX_METERS:
        raise ValueError(
            "must be a distance of 0 or more: meters, as 12.5, or a share of the diagonal, as 30%; "
            f"at most {MAX_METERS:.0f}"
        )
    return diagonal_m * number / 100 if text.strip().endswith("%") else number


def _as_text(value: object) -> object:
    return str(value) if isinstance(value, int | float) and not isinstance(value, bool) else value


def _check_range(text: str) -> str:
    range_in_meters(text, 0.0)
    return text


def _check_bandwidth(value: object) -> object:
    if isinstance(value, str) and value.isascii() and value.strip().isdecimal():
        value = int(value)
    if value != WORD_FOR_UNLIMITED and (type(value) is not int or not 0 <= value <= MAX_INTEGER):
        raise ValueError(f"must be a whole number of bytes per step, 0 to {MAX_INTEGER}, or 'unlimited'")
    return value


_EXACT: dict[object, tuple[tuple[type, ...], str]] = {
    bool: ((bool,), "true or false"),
    int: ((int,), "a whole number"),
    float: ((int, float), "a number"),
}


def check_types(hint: Any, value: object, name: str = "") -> None:
    """Raise ValueError if a truth value or a number within a table of a dataclass has another type, or is huge.

    Pydantic converts these: without this check, ``"yes"`` would be true.
    """
    if is_dataclass(hint) and isinstance(value, dict):
        for key, inner in get_type_hints(hint).items():
            if key in value:
                check_types(inner, value[key], key)
    elif get_origin(hint) is tuple and isinstance(value, list | tuple):
        for each in value:
            check_types(get_args(hint)[0], each, name)
    elif hint in _EXACT:
        kinds, wording = _EXACT[hint]
        if not isinstance(value, kinds) or isinstance(value, bool) != (hint is bool):
            raise ValueError(f"{name} = {shown(value)}: must be {wording}")
        if isinstance(value, int) and abs(value) > MAX_INTEGER:
            raise ValueError(f"{name} = {shown(value)}: must lie between -{MAX_INTEGER} and {MAX_INTEGER}")


Range = Annotated[str, BeforeValidator(_as_text), AfterValidator(_check_range)]
"""A communication range: meters, or a share of the map's diagonal."""
Bandwidth = Annotated[int | Literal["unlimited"], BeforeValidator(_check_bandwidth)]
"""Bytes per step for the whole team."""


class Table(BaseModel):
    """Base of all tables: immutable, without unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def exact(kind: type) -> BeforeValidator:
    """Return a validator of a table of the dataclass `kind`, which converts no types (`check_types`)."""

    def checked(value: object) -> object:
        check_types(kind, value)
        return value

    return BeforeValidator(checked)


def tables(name: str, kind: type[Table], hint: str = "") -> BeforeValidator:
    """Return a validator of the list of tables ``[[name]]``; `hint` ends the message for anything else."""

    def checked(value: object) -> object:
        if isinstance(value, list | tuple) and all(isinstance(each, dict | Table) for each in value):
            return value
        raise ValueError(f"must be tables, [[{name}]], of {', '.join(kind.model_fields)}{hint}")

    return BeforeValidator(checked)


def check_numbers(name: str, numbers: Sequence[int], robots: int) -> None:
    """Raise ValueError if tables ``[[name]]`` name a robot twice, or one beyond a team of this size."""
    for number in numbers:
        if number >= robots:
            raise ValueError(f"[[{name}]] names robot {number}; the last one is {robots - 1}")
    if len(set(numbers)) < len(numbers):
        raise ValueError(f"[[{name}]] names a robot twice: {[*numbers]}")


class FaultTable(Table):
    """A fault of one robot at one step; `event` is its form in messages (`protocol.faults`)."""

    step: Whole = Field(ge=1, le=MAX_INTEGER, description="the fault occurs at the start of this step")
    robot: Whole = Field(ge=0, le=MAX_INTEGER, description="the robot's number, from 0")
    kind: Kind = Field(description=", ".join(KINDS))
    steps: Whole = Field(
        0, ge=0, le=MAX_INTEGER, description=f"duration in steps of {', '.join(TEMPORARY)}; 0: permanent"
    )

    @property
    def event(self) -> FaultEvent:
        """This fault as a message."""
        return FaultEvent(self.step, self.robot, self.kind, self.steps)


class ChangeTable(Table):
    """A change of the radio from a step on; robots are not notified."""

    step: Whole = Field(ge=1, le=MAX_INTEGER, description="the change occurs at the start of this step")
    bandwidth: Bandwidth | None = Field(None, description="bytes per step for the whole team")
    range: Range | None = Field(None, description="communication range: meters, or % of the map's diagonal")

    @model_validator(mode="after")
    def _changes_something(self) -> Self:
        if self.bandwidth is None and self.range is None:
            raise ValueError(f"the change at step {self.step} changes neither bandwidth nor range")
        return self
