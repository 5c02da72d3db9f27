"""The hardware of a team's robots: ``[[robot]]`` tables, presets of lasers and poses, and their defaults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import Field

from deploy.scenario.tables import (
    MAX_INTEGER,
    Degrees,
    LimitOrNone,
    NotNegative,
    Positive,
    Table,
    Whole,
    exact,
)
from protocol.errors import shown, there_are
from worldsim.sensor_options import LASERS, POSES, LaserOptions, PoseOptions

PRESETS: Mapping[str, Mapping[str, Mapping[str, float]]] = {"laser": LASERS, "pose": POSES}
"""The presets of each table of sensors, by name."""


class RobotOverride(Table):
    """Hardware of one robot where it differs from the others'."""

    robot: Whole = Field(ge=0, le=MAX_INTEGER, description="the robot's number, from 0")
    sensor_range: Positive | None = Field(None, description="meters")
    field_of_view: Degrees | None = Field(None, gt=0, description="degrees")
    speed: Positive | None = Field(None, description="meters per step")
    send_bytes: LimitOrNone = Field(None, description="maximum bytes sent per step")
    receive_bytes: LimitOrNone = Field(None, description="maximum bytes received per step")
    radius: NotNegative | None = Field(None, description="meters; 0: a point")
    scanner_turn: Degrees | None = Field(None, ge=0, description="degrees per step; 0: full view at once")
    laser: Annotated[LaserOptions | None, exact(LaserOptions)] = Field(
        None, description="the name of a laser, or a table as `laser`, which it replaces as a whole"
    )
    pose: Annotated[PoseOptions | None, exact(PoseOptions)] = Field(
        None,
        description="the name of a localization method, or a table as `pose`, which it replaces as a whole",
    )

    @property
    def changes_body(self) -> bool:
        """Whether the robot has other hardware than a radio of its own."""
        radio = {"robot", "send_bytes", "receive_bytes"}
        return any(getattr(self, name) is not None for name in type(self).model_fields if name not in radio)


@dataclass(frozen=True)
class Hardware:
    """One robot's hardware; attributes are those of `RobotOverride`, and 0 bytes mean no limit."""

    robot: int
    sensor_range: float
    field_of_view: float
    speed: float
    send_bytes: int
    receive_bytes: int
    radius: float
    scanner_turn: float
    laser: LaserOptions
    pose: PoseOptions


def with_presets(data: dict[str, Any], where: str = "") -> dict[str, Any]:
    """Return a scenario's, or a robot's, settings with the values of its presets where it does not give its own.

    The name of a preset as the value of a table sets its ``preset``. A laser's preset may have a field of view.

    ValueError, whose text begins with `where`, if there is no such preset.
    """
    for table, presets in PRESETS.items():
        given = data.get(table)
        if isinstance(given, str):
            given = {"preset": given}
        if not isinstance(given, dict) or "preset" not in given:
            continue
        name = str(given["preset"])
        if name not in presets:
            raise ValueError(f"{where}{table}.preset = {shown(given['preset'])}: {there_are(presets, name)}")
        values = dict(presets[name])
        if "field_of_view" in values:
            data = {"field_of_view": values.pop("field_of_view")} | data
        data = data | {table: values | given}
    return data
