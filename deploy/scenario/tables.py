"""Types of scenario values, and the tables of a scenario: ``[[robot]]``, ``[[fault]]``, ``[[change]]``."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from netshaper.radio_options import LEAST_FRAME
from protocol.messages import FaultEvent

UNLIMITED = "unlimited"

MOST_INTEGER = 2**31 - 1
"""The largest integer that a ledger's columns can hold."""

MOST_METRES = 1e6

Whole = Annotated[int, Field(strict=True)]
Meters = Annotated[float, Field(strict=True, ge=-MOST_METRES, le=MOST_METRES)]
Positive = Annotated[float, Field(strict=True, gt=0, le=MOST_METRES)]
NotNegative = Annotated[float, Field(strict=True, ge=0, le=MOST_METRES)]
LimitOrNone = Annotated[int | None, Field(strict=True, ge=LEAST_FRAME, le=MOST_INTEGER)]
Degrees = Annotated[float, Field(strict=True, le=360)]


def range_in_metres(text: str, diagonal_m: float) -> float:
    """A communication range in metres on a map with such a diagonal."""
    number, is_share = _parse_range(text)
    return diagonal_m * number / 100 if is_share else number


def _parse_range(text: str) -> tuple[float, bool]:
    """Read a range: (number, whether it is a share of the diagonal in %); ValueError says what it must be."""
    share = text.strip().endswith("%")
    try:
        number = float(text.strip().removesuffix("%"))
    except ValueError:
        number = math.nan
    if not (number >= 0 and math.isfinite(number)):
        raise ValueError(
            "must be a distance of 0 or more: metres, as 12.5, or a share of the diagonal, as 30%"
        )
    return number, share


def _as_text(value: object) -> object:
    return str(value) if isinstance(value, int | float) and not isinstance(value, bool) else value


def _check_range(text: str) -> str:
    _parse_range(text)
    return text


def _check_bandwidth(value: object) -> object:
    if isinstance(value, str) and value.isascii() and value.strip().isdecimal():
        value = int(value)
    if value != UNLIMITED and (type(value) is not int or not 0 <= value <= MOST_INTEGER):
        raise ValueError(f"must be a whole number of bytes a step, 0 to {MOST_INTEGER}, or 'unlimited'")
    return value


Range = Annotated[str, BeforeValidator(_as_text), AfterValidator(_check_range)]
"""A communication range: metres, or a share of the map's diagonal."""
Bandwidth = Annotated[int | Literal["unlimited"], BeforeValidator(_check_bandwidth)]
"""Bytes a step for the whole team."""


class Table(BaseModel):
    """What all tables are: no other keys, and no changes."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class RobotOverride(Table):
    """Hardware of one robot that differs from the others."""

    robot: Whole = Field(ge=0, description="the robot's number, from 0")
    sensor_range: Positive | None = Field(None, description="metres")
    field_of_view: Degrees | None = Field(None, gt=0, description="degrees")
    speed: Positive | None = Field(None, description="metres a step")
    send_bytes: LimitOrNone = Field(None, description="bytes a step that it can send")
    receive_bytes: LimitOrNone = Field(None, description="bytes a step that it can take")
    radius: NotNegative | None = Field(None, description="metres; 0: a point")
    scanner_turn: Degrees | None = Field(None, ge=0, description="degrees a step; 0: full view at once")


class FaultTable(Table):
    """A fault of one robot at one step; `event` is its form in messages (`worldsim.faults`)."""

    step: Whole = Field(ge=1, le=MOST_INTEGER, description="the fault occurs at the start of this step")
    robot: Whole = Field(ge=0, description="the robot's number, from 0")
    kind: Literal["death", "kill", "restart", "stop", "mute", "deaf"] = Field(
        description="death, kill, restart, stop, mute, deaf"
    )
    steps: Whole = Field(
        0, ge=0, le=MOST_INTEGER, description="duration in steps of stop, mute and deaf; 0: permanent"
    )

    @property
    def event(self) -> FaultEvent:
        """This fault as a message."""
        return FaultEvent(self.step, self.robot, self.kind, self.steps)


class ChangeTable(Table):
    """Another radio from a step on; robots are not told."""

    step: Whole = Field(ge=1, le=MOST_INTEGER, description="the step at whose beginning it comes")
    bandwidth: Bandwidth | None = Field(None, description="bytes per step for the whole team")
    range: Range | None = Field(None, description="communication range: metres, or % of the map's diagonal")

    @model_validator(mode="after")
    def _changes_something(self) -> Self:
        if self.bandwidth is None and self.range is None:
            raise ValueError(f"the change at step {self.step} changes neither bandwidth nor range")
        return self
