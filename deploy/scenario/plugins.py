"""The settings of a scenario that plug-ins can replace, and checks of all plug-ins that a scenario names."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from operator import attrgetter
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, NamedTuple

from deploy.scenario.errors import ScenarioError
from protocol.plugins import MAIN, Plugins

if TYPE_CHECKING:
    from deploy.scenario.scenario import Scenario

ON_ROBOTS = ("strategy", "map_encoding", "dissemination")
"""The settings whose plug-ins each robot imports; the others only the relay and the launcher."""


class Named(NamedTuple):
    """A part that a scenario names."""

    setting: str
    """The setting, as ``radio.model``."""
    plugins: Plugins[Any]
    """All parts of its kind."""
    name: str


@cache
def kinds() -> dict[str, Plugins[Any]]:
    """Return the kinds of plug-ins, by the setting that names one."""
    from agent.encodings import catalog  # noqa: PLC0415  all of these load numpy and kernels, which --help does not need
    from agent.replication import engine  # noqa: PLC0415
    from agent.strategies import registry  # noqa: PLC0415
    from netshaper import radio_models  # noqa: PLC0415
    from protocol import presets  # noqa: PLC0415

    return {
        "strategy": registry.PLUGINS,
        "map_encoding": catalog.PLUGINS,
        "dissemination": engine.PLUGINS,
        "radio.model": radio_models.PLUGINS,
        "radio.preset": presets.PLUGINS,
    }


def plain_settings(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings as a TOML file has them.

    Names replace classes of plug-ins, text replaces paths, and numbers and lists replace those of numpy, pandas, and
    polars, also within lists and tables. Raises ValueError as `Plugins.name_of`.
    """
    return {setting: _plain(setting, value) for setting, value in settings.items()}


def _plain(setting: str, value: Any) -> Any:
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, type):
        return kinds()[setting].name_of(value) if setting in kinds() else value
    for convert in ("tolist", "to_list"):  # numpy and pandas, polars
        if hasattr(value, convert):
            return getattr(value, convert)()
    if isinstance(value, dict):
        return {key: _plain(f"{setting}.{key}", each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(_plain(setting, each) for each in value)
    return value


def own_name(setting: str, value: str) -> str:
    """Return the name that a plug-in given as ``module:Class`` has itself; all other values unchanged."""
    try:
        return str(getattr(kinds()[setting].find(value), "name", value)) if ":" in value else value
    except (KeyError, ValueError):
        return value


def named(scenario: Scenario) -> Iterator[Named]:
    """Yield all parts that a scenario names."""
    for setting, plugins in kinds().items():
        if name := attrgetter(setting)(scenario):
            yield Named(setting, plugins, name)


def on_robots(scenario: Scenario) -> dict[str, str]:
    """Return the plug-ins that the robots of a scenario import, by setting."""
    return {
        each.setting: each.name
        for each in named(scenario)
        if each.setting in ON_ROBOTS and each.name not in each.plugins.built_in
    }


def check_importable(scenario: Scenario, who: str, instead: str = "") -> None:
    """Raise ScenarioError if a plug-in is defined in a script or a notebook, which other processes cannot import.

    The message names these processes (`who`), and what helps `instead` of a module.
    """
    for setting, _, name in named(scenario):
        module, _, part = name.partition(":")
        if module == MAIN:
            raise ScenarioError(
                f"{setting} = {name!r}: is defined in a script or a notebook, from which {who} cannot import it; "
                f"move it into a module, as my_code.py, and give my_code:{part} or the imported class{instead}"
            )


def check_distinct(scenarios: Iterable[Scenario]) -> None:
    """Raise ScenarioError if two plug-ins of one kind have the same name."""
    taken: dict[tuple[str, str], str] = {}
    for setting, plugins, name in (each for scenario in scenarios for each in named(scenario)):
        if ":" in name and plugins.are_classes:
            own = plugins.find(name).name
            other = taken.setdefault((setting, own), name)
            if other != name:
                raise ScenarioError(
                    f"{setting} = {name!r}: has the name {own!r} of {other}; give it another one"
                )


def digests(parts: Mapping[str, str]) -> tuple[dict[str, str], dict[str, str]]:
    """Return the SHA-256 of the modules of plug-ins, by setting, and why others cannot be imported."""
    found: dict[str, str] = {}
    missing: dict[str, str] = {}
    for setting, name in parts.items():
        try:
            found[setting] = hashlib.sha256(kinds()[setting].source(name).encode()).hexdigest()
        except ValueError as error:
            missing[setting] = str(error)
    return found, missing


def sources(scenario: Scenario) -> dict[str, str]:
    """Return the sources of the modules of all plug-ins that a scenario names, by setting."""
    return {
        setting: plugins.source(name)
        for setting, plugins, name in named(scenario)
        if name not in plugins.built_in
    }
