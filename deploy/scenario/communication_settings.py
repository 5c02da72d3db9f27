"""Settings of communication: the radio, and how robots offer their maps."""

from __future__ import annotations

from collections import Counter
from typing import Annotated, Any, Self

from pydantic import Field, field_validator, model_validator

from deploy.scenario import plugins
from deploy.scenario.radio_presets import preset_settings
from deploy.scenario.tables import Bandwidth, ChangeTable, Range, Table, Whole, exact, range_in_meters, tables
from netshaper.radio_options import RadioOptions
from protocol.budget import WORD_FOR_UNLIMITED, Budget
from protocol.messages import Change
from protocol.packets import MAX_GOSSIP_MAPS, MAX_MAPS


class CommunicationSettings(Table):
    """Range and bandwidth, options of the radio and their changes, and the dissemination of maps."""

    range: Range = Field("100%", description="communication range: meters, or % of the map's diagonal")
    bandwidth: Bandwidth = Field(1000, description="bytes per step for the whole team")
    rounds: Whole = Field(2, ge=1, le=16, description="rounds of the medium per step (R)")
    dissemination: str = Field(
        default_factory=lambda given: "gossip" if given.get("map_encoding") == "predictive" else "backoff",
        description="when maps are offered (default gossip with predictive, else backoff): backoff, thesis, gossip",
    )
    digests: bool = Field(
        False,
        description="whether robots broadcast digests of their logs, which expose forged entries",
        strict=True,
    )
    forward_maps: bool = Field(True, description="whether robots also offer the maps of others", strict=True)
    radio: Annotated[RadioOptions, exact(RadioOptions)] = Field(
        default_factory=RadioOptions, description="options of the radio"
    )
    change: Annotated[tuple[ChangeTable, ...], tables("change", ChangeTable)] = Field(
        (), description="changes of the radio's bandwidth or range"
    )

    @model_validator(mode="before")
    @classmethod
    def _take_preset(cls, data: Any) -> Any:
        """Fill in the radio preset's values where the scenario does not give its own."""
        radio = data.get("radio") if isinstance(data, dict) else None
        if isinstance(radio, str | list | tuple):
            radio = {"preset": radio}
        if not isinstance(radio, dict) or not radio.get("preset"):
            return data
        return data | preset_settings(data | {"radio": radio})

    @field_validator("dissemination")
    @classmethod
    def _dissemination_is_known(cls, value: str) -> str:
        plugins.kinds()["dissemination"].find(value)
        return value

    @model_validator(mode="after")
    def _radio_is_consistent(self) -> Self:
        plugins.kinds()["radio.model"].find(self.radio.model)
        if not self.forward_maps and self.dissemination == "gossip":
            raise ValueError("forward_maps = false: dissemination = 'gossip' forwards all maps; omit one")
        for key in ("bandwidth", "range"):
            changed = Counter(each.step for each in self.change if getattr(each, key) is not None)
            for step, number in changed.items():
                if number > 1:
                    raise ValueError(f"{number} tables [[change]] set {key} at step {step}; keep one of them")
        bandwidths = [self.bandwidth, *(change.bandwidth for change in self.change)]
        if self.radio.duty_cycle < 1 and WORD_FOR_UNLIMITED in bandwidths:
            raise ValueError(
                f"radio.duty_cycle = {self.radio.duty_cycle:g}: is a share of the bandwidth, which must be limited; "
                "1 means no duty cycle"
            )
        return self

    def range_m(self, diagonal_m: float) -> float:
        """Return the communication range in meters, on a map with this diagonal in meters."""
        return range_in_meters(self.range, diagonal_m)

    def changes(self, diagonal_m: float) -> tuple[Change, ...]:
        """Return the changes of the radio by step, in the form of messages; `diagonal_m` is the map's, in meters."""
        return tuple(
            Change(
                each.step,
                None if each.bandwidth is None else Budget.parse(each.bandwidth),
                None if each.range is None else round(1000 * range_in_meters(each.range, diagonal_m)),
            )
            for each in sorted(self.change, key=lambda each: each.step)
        )

    @property
    def most_maps(self) -> int:
        """Number of maps that packets can address; offers have fewer bits for the map than gossip packets."""
        return MAX_GOSSIP_MAPS if self.dissemination == "gossip" else MAX_MAPS
