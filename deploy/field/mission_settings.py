"""Durations of a mission of a robot in the field."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from deploy.scenario.tables import MAX_INTEGER, Table, Whole

Seconds = Annotated[float, Field(strict=True, gt=0, le=86400)]


class MissionSettings(Table):
    """How long a mission and its steps take, and how long the robot waits for sensors, goals, and teammates."""

    step_s: float = Field(1.0, strict=True, ge=0.1, le=60.0, description="duration of a step, seconds")
    steps: Whole = Field(86400, ge=1, le=MAX_INTEGER, description="maximum number of steps")
    finish_s: Seconds = Field(
        30.0, description="the robot ends when it was done for so long: nothing to explore, and all delivered"
    )
    dead_man_s: Seconds = Field(
        3.0, description="the robot stands still if no scan with a pose has arrived for so long, seconds"
    )
    patience_s: Seconds = Field(20.0, description="a goal without progress for so long counts as unreachable")
    avoid_s: Seconds = Field(60.0, description="how long an unreachable goal is avoided, at first")
    absent_s: Seconds = Field(
        300.0, description="a teammate that has not been received for so long is not waited for at the end"
    )
