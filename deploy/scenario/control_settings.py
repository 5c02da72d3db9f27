"""Settings of a robot's control logic, simulated or in the field: its strategy, and how it encodes its map."""

from __future__ import annotations

from typing import Annotated, Any, Self

from pydantic import Field, field_validator, model_validator

from agent.encoding_options import PolygonOptions, PredictiveOptions
from agent.settings import EncodingSettings
from deploy.scenario.tables import MAX_INTEGER, MAX_TOLERANCE, Table, Whole, exact

DEFAULT_STRATEGY = "repairmen"

MAX_FRONTIER_SIZE = 5.0
"""Largest `min_frontier_size`, in meters: wider than most doors."""


class ControlSettings(Table):
    """The strategy with its options, and the map encoding with its options."""

    strategy: str = Field(DEFAULT_STRATEGY, description="exploration strategy (murmur strategies lists all)")
    options: dict[str, Any] = Field(default_factory=dict, description="options of the strategy, by name")
    map_encoding: str = Field(
        "predictive",
        description="map encoding: polygons, scans, cells, predictive, slam-toolbox, zstd-maps, none",
    )
    polygons: Annotated[PolygonOptions, exact(PolygonOptions)] = Field(
        default_factory=PolygonOptions, description="options of the polygon encoding"
    )
    predictive: Annotated[PredictiveOptions, exact(PredictiveOptions)] = Field(
        default_factory=PredictiveOptions, description="options of the predictive encoding"
    )
    tolerance: Whole = Field(
        1, ge=0, le=MAX_TOLERANCE, description="cells between a wall and its copy on teammates' maps at most"
    )

    min_frontier_size: float = Field(
        0.0,
        strict=True,
        ge=0,
        le=MAX_FRONTIER_SIZE,
        description="frontiers that are smaller are not explored, meters; 0: all are (docs/strategies.md)",
    )

    @field_validator("map_encoding")
    @classmethod
    def _encoding_is_known(cls, value: str) -> str:
        from agent.encodings.catalog import encoding_class  # noqa: PLC0415  loads kernels, which --help does not need

        encoding_class(value)
        return value

    @field_validator("options")
    @classmethod
    def _options_are_plain(cls, value: dict[str, Any]) -> dict[str, Any]:
        for name, option in value.items():
            if isinstance(option, int | float) and not abs(option) <= MAX_INTEGER:
                raise ValueError(f"{name} must lie between -{MAX_INTEGER} and {MAX_INTEGER}")
        return value

    @model_validator(mode="after")
    def _strategy_has_these_options(self) -> Self:
        from agent.strategies.registry import strategy  # noqa: PLC0415  loads kernels, which --help does not need

        strategy(self.strategy).check(self.options)
        return self

    @property
    def encoding(self) -> EncodingSettings:
        """The settings of the map encoding, as robots receive them."""
        return EncodingSettings(self.map_encoding, self.polygons, self.predictive, self.tolerance)
