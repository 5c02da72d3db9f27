"""Settings of the team: the number of robots, their hardware, and how they move."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from deploy.scenario.hardware import Hardware, RobotOverride, with_presets
from deploy.scenario.tables import Degrees, NotNegative, Positive, Table, Whole, check_numbers, exact, tables
from protocol.grid import MAX_ROBOTS
from worldsim.sensor_options import LaserOptions, PoseOptions


class TeamSettings(Table):
    """The robots; a table ``[[robot]]`` gives one of them other hardware."""

    robots: Whole = Field(3, ge=1, le=MAX_ROBOTS, description="number of robots")
    sensor_range: Positive = Field(5.0, description="laser range, meters")
    field_of_view: Degrees = Field(360.0, gt=0, description="degrees")
    scanner_turn: Degrees = Field(
        0.0, ge=0, description="degrees that scanners turn per step; 0: full view at once"
    )
    beams: Whole = Field(360, ge=4, le=3600, multiple_of=4, description="laser beams per full turn")
    speed: Positive = Field(0.5, description="meters per step")
    radius: NotNegative = Field(0.0, description="radius of the robots, which are discs, meters; 0: points")
    laser: Annotated[LaserOptions, exact(LaserOptions)] = Field(
        default_factory=LaserOptions, description="errors of the lasers"
    )
    pose: Annotated[PoseOptions, exact(PoseOptions)] = Field(
        default_factory=PoseOptions, description="errors of the poses that robots believe in"
    )
    robot: Annotated[
        tuple[RobotOverride, ...], tables("robot", RobotOverride, "; number of robots is `robots`")
    ] = Field((), description="robots with different hardware")
    motion: Literal["meters", "cells"] = Field(
        "meters", description="length of a diagonal step: meters: sqrt 2 cells; cells: 1 cell"
    )
    robots_collide: Annotated[bool, Field(strict=True)] = Field(
        True, description="whether robots block each other's paths and laser beams"
    )
    interference: NotNegative = Field(0.0, description="robots closer than this hinder each other, meters")

    @model_validator(mode="before")
    @classmethod
    def _take_sensor_presets(cls, data: Any) -> Any:
        """Fill in the values of presets of lasers and poses, of the team and of single robots."""
        if not isinstance(data, dict):
            return data
        data = with_presets(data)
        robots = data.get("robot")
        if not isinstance(robots, list | tuple):
            return data
        return data | {
            "robot": [
                with_presets(each, f"robot.{place}.") if isinstance(each, dict) else each
                for place, each in enumerate(robots)
            ]
        }

    @model_validator(mode="after")
    def _hardware_is_consistent(self) -> Self:
        for hardware in map(self.body_of, range(self.robots)):
            if hardware.laser.rate < 1 and hardware.scanner_turn:
                raise ValueError(
                    f"laser.rate = {hardware.laser.rate:g}: a turning scanner (scanner_turn) measures in every step"
                )
        check_numbers("robot", [entry.robot for entry in self.robot], self.robots)
        return self

    def body_of(self, number: int) -> Hardware:
        """Return the hardware of one robot: its own where a table gives it, else that of the team."""
        own = next((entry for entry in self.robot if entry.robot == number), RobotOverride(robot=number))
        team = {"send_bytes": 0, "receive_bytes": 0} | dict(self)
        values = {name: team[name] if value is None else value for name, value in own}
        return Hardware(**values)


def has_errors(given: Mapping[str, Any]) -> bool:
    """Return whether any robot's laser or pose has errors, by the valid settings of a team."""
    robots: tuple[RobotOverride, ...] = given.get("robot", ())
    laser, pose = given.get("laser", LaserOptions()), given.get("pose", PoseOptions())
    lasers, poses = [each.laser or laser for each in robots], [each.pose or pose for each in robots]
    if len(robots) < given.get("robots", math.inf):
        lasers, poses = [*lasers, laser], [*poses, pose]
    return not (all(each.is_ideal for each in lasers) and all(each.is_exact for each in poses))
