"""Flags that set settings of a scenario: most are derived from it, some have another name or unit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from deploy.commands.flag_values import duration_s, named_values, position
from deploy.commands.flags import RADIO, ROBOTS, RUN, WORLD, Command, Flag, flag, option, with_flags
from protocol.presets import PRESETS
from worldsim.sensor_options import LASERS, POSES

SETTINGS = {
    WORLD: {"map": "FILE|NAME", "map_seed": "S", "start": "X,Y"},
    ROBOTS: {
        "robots": "N", "strategy": "NAME", "sensor_range": "METERS", "speed": "METERS",
        "min_frontier_size": "METERS",
    },
    RADIO: {
        "range": "METERS|P%", "bandwidth": "BYTES|unlimited", "map_encoding": "NAME", "dissemination": "NAME",
        "tolerance": "CELLS",
    },
    RUN: {
        "seed": "S", "steps": "MAX", "finish": "first|all", "bus": "zenoh|memory", "clock": "barrier|wall",
    },
}  # fmt: skip
"""Settings with a flag of the same name, by group of the help, each with the metavar of its value."""


SET_OPTION = option(
    "KEY=VALUE",
    "any other setting, as radio.loss=0.1 or polygons.lazy=false; repeatable",
    RUN,
    name="--set",
)


KEYS = {
    "map_options.resolution": flag(
        "resolution",
        float,
        option("METERS", "cell size of a generated map, or of a map that is a picture", WORLD),
    ),
    "laser.preset": flag(
        "laser", str, option("NAME", f"a laser with its errors: {', '.join(LASERS)}", ROBOTS)
    ),
    "pose.preset": flag(
        "pose", str, option("NAME", f"errors of the robots' poses: {', '.join(POSES)}", ROBOTS)
    ),
    "radio.preset": flag(
        "radio",
        str,
        option("NAME", f"a radio preset (bandwidth, frame size, range): {', '.join(PRESETS)}", RADIO),
    ),
    "people.number": flag(
        "people", int, option("N", "people who walk about in the building (docs/real-sensors.md)", WORLD)
    ),
    "step_s": flag(
        "step", str, option("DURATION", "duration of a step with --clock wall, as 200ms (default 1s)", RUN)
    ),
}
"""Flags with another name or unit than their setting, by the name of the setting."""

STUDIED = ("map_options.resolution", "laser.preset", "pose.preset", "people.number")
"""Keys of `KEYS` with a flag in commands for many runs."""

PARSERS: dict[str, Callable[[Any], Any]] = {"start": position, "step_s": duration_s}
"""Functions that return the value of a setting from that of its flag, where they differ."""


def setting_flags(*without: str) -> Callable[[Command], Command]:
    """Give a command for many runs a flag for each of `SETTINGS` but those in `without`, and those of `STUDIED`.

    The command receives the settings that the user gave as the dictionary `settings`.
    """
    own = {key: KEYS[key] for key in STUDIED}
    flags = [*_derived_flags(without), *own.values()]
    return lambda command: with_flags(command, flags, "settings", lambda **values: _given(values, own))


def run_flags(*without: str, more: dict[str, Flag] | None = None) -> Callable[[Command], Command]:
    """Give a command of one run the flags of `SETTINGS` and `KEYS` but those in `without`, and ``--set``.

    Flags in `more` replace those of the same settings. The command receives the settings that the user gave as the
    dictionary `settings`. It raises ValueError if ``--set`` and a flag give the same setting.
    """
    more = more or {}
    own = {key: each for key, each in KEYS.items() if key not in without} | more
    flags = [
        *_derived_flags((*without, *more)),
        *own.values(),
        flag("set_", list[str], SET_OPTION),
    ]

    def given(set_: list[str] | None, **values: Any) -> dict[str, Any]:
        settings = _given(values, own)
        others = named_values(set_ or [], "set", "radius=0.2")
        for key in sorted(others.keys() & settings.keys()):
            name = own[key].name if key in own else key
            raise ValueError(f"set = '{key}=...': --{_dashed(name)} is given, too; remove one of them")
        return settings | others

    return lambda command: with_flags(command, flags, "settings", given)


def _given(values: dict[str, Any], own: Mapping[str, Flag]) -> dict[str, Any]:
    """Return the settings that flags give, by name of the setting."""
    settings = {key: values.pop(each.name) for key, each in own.items()} | values
    given = {name: value for name, value in settings.items() if value is not None}
    return given | {name: parse(given[name]) for name, parse in PARSERS.items() if name in given}


def _derived_flags(without: tuple[str, ...]) -> list[Flag]:
    """Return a flag for each of `SETTINGS` but those in `without`, with the setting's type, text, and default."""
    from deploy.scenario.scenario import Scenario  # noqa: PLC0415  not all commands have settings

    flags = []
    for group, names in SETTINGS.items():
        for name, metavar in names.items():
            if name in without:
                continue
            info = Scenario.model_fields[name]
            kind: Any = info.annotation if info.annotation in (int, float) else str
            has_default = info.default is not None and info.default_factory is None
            text = f"{info.description}" + (f" (default {info.default})" if has_default else "")
            flags.append(flag(name, kind, option(metavar, text, group, name=f"--{_dashed(name)}")))
    return flags


def _dashed(name: str) -> str:
    """Return the name of a flag as the user writes it, without its dashes in front."""
    return name.replace("_", "-")
