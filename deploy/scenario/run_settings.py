"""Settings of a run: its seed, its clock, its end, and faults of robots."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from deploy.scenario.tables import MAX_INTEGER, FaultTable, Positive, Table, Whole, tables
from protocol.messages import FaultEvent


class RunSettings(Table):
    """How a run is executed, when it ends, and which robots fail in it."""

    seed: Whole = Field(
        0, ge=0, le=MAX_INTEGER, description="seed of the start poses and of all random draws"
    )
    bus: Literal["zenoh", "memory"] = Field(
        "zenoh", description="zenoh: one process per participant; memory: all in one process"
    )
    clock: Literal["barrier", "wall", "field"] = Field(
        "barrier",
        description="barrier: a step waits for all robots; wall: it ends on time (docs/clocks.md)",
    )
    step_s: float = Field(
        1.0, strict=True, ge=0.01, le=60.0, description="duration of a step by the wall clock, seconds"
    )
    steps: Whole = Field(10000, ge=1, le=MAX_INTEGER, description="maximum number of steps")
    reply_timeout_s: Positive = Field(
        60.0, description="time limit for a robot's reply or move, seconds of wall clock"
    )
    min_coverage: float = Field(
        0.97,
        strict=True,
        ge=0,
        le=1,
        description="fraction of the reachable area that the team must have seen when a robot ends the run",
    )
    finish: Literal["first", "all"] = Field(
        "first", description="robots that must have finished for the run to end: the first one, or all"
    )
    fault: Annotated[tuple[FaultTable, ...], tables("fault", FaultTable)] = Field(
        (), description="faults of robots: breakdowns, restarts, radio failures"
    )

    @model_validator(mode="after")
    def _duration_has_a_clock(self) -> Self:
        if self.clock == "barrier" and self.step_s != type(self).model_fields["step_s"].default:
            raise ValueError(f"step_s = {self.step_s:g}: steps have a duration only with clock = 'wall'")
        return self

    @property
    def step_ns(self) -> int | None:
        """Duration of a step in nanoseconds; None: steps wait for all robots."""
        return round(1e9 * self.step_s) if self.clock == "wall" else None

    @property
    def is_field(self) -> bool:
        """Whether this is a record of robots in the field, which cannot be run."""
        return self.clock == "field"

    @property
    def faults(self) -> tuple[FaultEvent, ...]:
        """The scheduled faults, by step."""
        return tuple(sorted(fault.event for fault in self.fault))
