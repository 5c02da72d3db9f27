"""Options of lasers and of pose errors, and their presets; docs/real-sensors.md names the sources of the figures."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated

from protocol.bounds import Options, Range
from protocol.range_scans import MAX_REACH_M

IDEAL, EXACT = "ideal", "exact"

Share = Annotated[float, Range(0, 1)]


@dataclass(frozen=True)
class LaserOptions(Options):
    """The robots' laser scanners. Without any error they are exact, and a scan consists of whole cells."""

    preset: str = IDEAL
    """Laser by name, for values that the scenario does not give (`LASERS`); ``ideal`` has no errors."""
    range_error_m: Annotated[float, Range(0, 1, "m")] = 0.0
    """Standard deviation of a range, meters."""
    range_error_share: Share = 0.0
    """Standard deviation of a range, as a share of the range, in addition to `range_error_m`."""
    short: Share = 0.0
    """Probability that a beam ends early, at something that passes by."""
    missing: Share = 0.0
    """Probability that a beam has no return, as from glass and black surfaces."""
    mixed: Share = 0.0
    """Probability that a beam beside an edge measures a range between its two surfaces."""
    min_range_m: Annotated[float, Range(0, 10, "m")] = 0.0
    """Shortest range, meters; below, there is no measurement."""
    max_range_m: Annotated[float, Range(0, MAX_REACH_M, "m")] = 0.0
    """Longest range, meters, up to which robots see and map; 0: no limit of the laser."""
    beams: Annotated[int, Range(0, 1440)] = 0
    """Beams over the field of view; 0: as many as `beams` of the scenario has there."""
    rate: Annotated[float, Range(0.01, 1, "scans per step")] = 1.0
    """Scans per step, at most 1; 0.2: a scan every fifth step. A robot maps one scan at the end of its motion."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.short + self.missing > 1:
            raise ValueError(
                "short + missing: exclude each other, so their probabilities are together at most 1"
            )
        if 0 < self.max_range_m <= self.min_range_m:
            raise ValueError(f"max_range_m = {self.max_range_m:g}: must exceed min_range_m")

    @property
    def is_ideal(self) -> bool:
        """Whether the laser has no errors and no limits of its own; it may scan in some steps only."""
        figures = [field for field in fields(self) if field.name not in ("preset", "rate")]
        return all(getattr(self, field.name) == field.default for field in figures)


@dataclass(frozen=True)
class PoseOptions(Options):
    """The errors that localization leaves: bounded and slowly varying, different for each robot."""

    preset: str = EXACT
    """Localization method, for values that the scenario does not give (`POSES`); ``exact`` has no errors."""
    position_error_m: Annotated[float, Range(0, 1, "m")] = 0.0
    """Standard deviation of each coordinate, meters; no error exceeds three of them."""
    heading_error_deg: Annotated[float, Range(0, 10, "degrees")] = 0.0
    """Standard deviation of the heading, degrees; no error exceeds three of them."""

    @property
    def is_exact(self) -> bool:
        """Whether robots know exactly where they are."""
        return self.position_error_m == self.heading_error_deg == 0


LASERS: dict[str, dict[str, float]] = {
    IDEAL: {},
    "sick-lms": {
        "range_error_m": 0.012, "short": 0.002, "missing": 0.003, "mixed": 0.1,
        "min_range_m": 0.05, "max_range_m": 20.0, "beams": 541, "field_of_view": 270.0,
    },
    "utm-30lx": {
        "range_error_m": 0.03, "short": 0.002, "missing": 0.005, "mixed": 0.1,
        "min_range_m": 0.1, "max_range_m": 30.0, "beams": 1081, "field_of_view": 270.0,
    },
    "rplidar-a1": {
        "range_error_m": 0.01, "range_error_share": 0.01, "short": 0.005, "missing": 0.02, "mixed": 0.2,
        "min_range_m": 0.15, "max_range_m": 12.0, "beams": 360, "field_of_view": 360.0,
    },
}  # fmt: skip
"""The options that each laser sets, and the scenario's field of view in degrees."""

POSES: dict[str, dict[str, float]] = {
    EXACT: {},
    "graph-slam": {"position_error_m": 0.03, "heading_error_deg": 0.2},
    "particle-filter": {"position_error_m": 0.05, "heading_error_deg": 0.4},
}
"""The options that each localization method sets."""
