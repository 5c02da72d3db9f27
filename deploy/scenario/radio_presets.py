"""The settings that a radio preset gives a scenario (docs/radios.md)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from netshaper.radio_options import LOG_DISTANCE
from protocol.budget import WORD_FOR_UNLIMITED
from protocol.errors import shown
from protocol.presets import EXPONENT, Preset, preset

RADIO_KEYS = ("frame_bytes", "duty_cycle", "model", "exponent", "db_per_meter", "db_per_wall")
"""Keys of the table `radio` that presets set; a preset from overrides replaces them, bandwidth, and range."""


def preset_settings(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return bandwidth, range, and the table `radio` of a scenario whose radio has a preset.

    The `given` settings take precedence. With a range of their own and no model, the range is that of a disc. Otherwise
    walls weaken a radio with a link budget, and the range is that without walls. An unlimited bandwidth has no duty
    cycle.

    Raises ValueError if there is no such preset.
    """
    radio = given["radio"]
    chosen = preset_of(radio["preset"])
    taken: dict[str, Any] = {"frame_bytes": chosen.frame_bytes}
    if given.get("bandwidth") != WORD_FOR_UNLIMITED:
        taken["duty_cycle"] = chosen.limit.duty_cycle
    if chosen.link is not None:
        if "range" not in given:
            taken["model"] = LOG_DISTANCE
        if (taken | radio).get("model") == LOG_DISTANCE:
            taken |= {"exponent": EXPONENT, "db_per_wall": chosen.link.db_per_wall}
    return {
        "bandwidth": given.get("bandwidth", chosen.bandwidth),
        "range": given.get("range", str(chosen.range_m)),
        "radio": taken | radio,
    }


def preset_of(name: object) -> Preset:
    """Return a radio preset; ValueError if there is none of this name."""
    if isinstance(name, list | tuple):
        raise ValueError(
            f"radio.preset = {shown(name)}: must be one name; lists are axes of sweep, compare, and size"
        )
    if not isinstance(name, str):
        raise ValueError(f"radio.preset = {shown(name)}: must be a name")
    return preset(name)
