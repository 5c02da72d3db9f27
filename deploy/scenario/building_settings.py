"""Settings of the environment: a building with people in it, or logs of a real one."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from deploy.scenario.tables import MAX_INTEGER, Meters, NotNegative, Positive, Table, Whole, exact
from worldsim.people_options import PeopleOptions
from worldsim.recorded.options import RecordingOptions


class BuildingSettings(Table):
    """The map, its people, where robots start on it, and logs that replace it."""

    map: str = Field("office", description="a map's YAML file, or the name of a generator (murmur map list)")
    map_seed: Whole = Field(0, ge=0, le=MAX_INTEGER, description="seed of the generator")
    map_options: dict[str, Meters] = Field(
        default_factory=dict, description="parameters of the generator: resolution, width_m, ..."
    )
    people: Annotated[PeopleOptions, exact(PeopleOptions)] = Field(
        default_factory=PeopleOptions, description="people in the building"
    )
    recording: Annotated[RecordingOptions, exact(RecordingOptions)] = Field(
        default_factory=RecordingOptions, description="logs that robots replay instead of exploring"
    )
    start: tuple[Meters, Meters] | None = Field(
        None, description="start position, meters in the map's frame; drawn from the seed by default"
    )
    starts: tuple[tuple[Meters, Meters], ...] = Field(
        (),
        description="start positions of the first robots, meters in the map's frame; the others start around start",
    )
    start_jitter: NotNegative = Field(0.0, description="maximum random offset of the start positions, meters")
    start_spacing: Positive = Field(0.3, description="minimum distance between start positions, meters")

    @model_validator(mode="after")
    def _jitter_has_a_start(self) -> Self:
        if self.start_jitter and self.start is None and not self.starts:
            raise ValueError("start_jitter: offsets a given start position: set start or starts")
        return self

    @property
    def is_recorded(self) -> bool:
        """Whether robots replay logs."""
        return bool(self.recording.files)
