"""Settings as dictionaries: read from TOML files, and laid over others, before they are validated."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from deploy.scenario.errors import ScenarioError
from deploy.scenario.finding_maps import FILES as MAP_FILES
from deploy.scenario.finding_maps import located
from deploy.scenario.hardware import PRESETS
from deploy.scenario.radio_presets import RADIO_KEYS
from protocol.errors import there_are
from protocol.files import read_file
from worldsim import generators

NAMED = ("radio", *PRESETS)
"""Tables that a name can stand for: that of a preset."""


def remove_preset_keys(data: dict[str, Any], overrides: dict[str, Any]) -> None:
    """Remove the settings that presets from the overrides replace."""
    if overrides.get("radio.preset") or isinstance(overrides.get("radio"), str):
        for key in ("bandwidth", "range"):
            data.pop(key, None)
        if isinstance(data.get("radio"), dict):
            data["radio"] = {key: value for key, value in data["radio"].items() if key not in RADIO_KEYS}
    for table, presets in PRESETS.items():
        if name := overrides.get(f"{table}.preset") or overrides.get(table):
            data.pop(table, None)
            if "field_of_view" in presets.get(str(name), {}):
                data.pop("field_of_view", None)


def lay(data: dict[str, Any], settings: dict[str, Any], where: str) -> None:
    """Lay settings over others; a dotted name (``options.beta``) sets one key of a table.

    A name as the value of ``radio``, ``laser``, or ``pose`` sets its ``preset``.

    Raises ScenarioError, which begins with `where`, if a dotted name refers to a key of something else than a table.
    """
    for name, value in settings.items():
        key = f"{name}.preset" if name in NAMED and isinstance(value, str) else name
        table, dot, inner = key.partition(".")
        if dot:
            keys = data.get(table, {})
            if table in NAMED and isinstance(keys, str):
                keys = {"preset": keys}
            if not isinstance(keys, dict):
                raise ScenarioError(
                    f"{where}: {table} = {keys!r}: must be a table, for {key!r} sets a key of it"
                )
            data[table] = {**keys, inner: value}
        else:
            data[key] = value


def read_toml(path: Path, kind: str, shipped: Path | None = None) -> tuple[Path, dict[str, Any]]:
    """Read a TOML file; return its path and its content. Error messages name its `kind`, for example a scenario.

    A file name alone that does not exist refers to a file in the directory `shipped`, if that is given.

    Raises ScenarioError if the file cannot be read, or is not TOML.
    """
    is_generator = str(path) in generators.names() and not path.exists()
    if kind == "scenario" and (is_generator or path.suffix.lower() in MAP_FILES):
        raise ScenarioError(f"scenario {path}: is a map, not a scenario; give it as --map {path}")
    if shipped and len(path.parts) == 1 and not path.exists() and (shipped / path.name).exists():
        path = shipped / path.name
    try:
        return path, tomllib.loads(read_file(path).decode("utf-8-sig"))
    except RecursionError:
        raise ScenarioError(f"{kind} {path}: is nested too deeply") from None
    except FileNotFoundError:
        names = [file.name for file in shipped.glob("*.toml")] if shipped else []
        others = f", and no shipped {kind}; {there_are(sorted(names), path.name)}" if names else ""
        setting = f"; to change a setting: --set {path}" if "=" in path.name else ""
        raise ScenarioError(f"{kind} {path}: no such file{others}{setting}") from None
    except OSError as error:
        raise ScenarioError(f"{kind} {path}: {error.strerror or error}") from None
    except ValueError as error:
        raise ScenarioError(f"{kind} {path}: not TOML: {error}") from None


def beside(path: Path, named: Any) -> Any:
    """Return the path of the map `named` in the file `path`; the name of a generator is returned unchanged.

    A map file is searched in the directory of `path`, then in the directory of the environment variable MURMUR_MAPS.
    """
    if not isinstance(named, str) or Path(named).suffix.lower() not in MAP_FILES:
        return named
    return located(named, path.parent)
