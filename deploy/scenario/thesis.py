"""Settings for the thesis' plain rules, without our improvements of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from agent.encoding_options import THESIS_OPTIONS, PolygonOptions

ENCODING, DISSEMINATIONS, STRATEGY = "polygons", "thesis", "meier"

PLAIN_OPTIONS: dict[str, dict[str, Any]] = {"meier": {"herding": False}}
"""Strategy options that switch off our additions: the rule against herding is not in the thesis."""


def with_thesis(settings: Mapping[str, Any], scenario: Mapping[str, Any]) -> dict[str, Any]:
    """Return `settings`, and those of the thesis' plain rules where they have none (``--thesis``).

    These replace values of the `scenario` over which the settings are laid, but not its strategy.
    """
    chosen = {"strategy": scenario.get("strategy", STRATEGY), **settings}
    return chosen | thesis_settings(chosen)


def thesis_settings(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings for the thesis' plain rules, by dotted names, for `deploy.scenario.toml_files.lay`.

    `given` are settings that take precedence, by dotted names or in tables; they may contain a strategy.
    """
    strategy = str(given.get("strategy", STRATEGY))
    ours = asdict(PolygonOptions())
    plain = {"map_encoding": ENCODING, "dissemination": DISSEMINATIONS, "strategy": strategy}
    plain |= {
        f"polygons.{name}": value for name, value in asdict(THESIS_OPTIONS).items() if value != ours[name]
    }
    plain |= {f"options.{name}": value for name, value in PLAIN_OPTIONS.get(strategy, {}).items()}
    tables = {table: keys for table, keys in given.items() if isinstance(keys, Mapping)}
    own = {*given, *(f"{table}.{name}" for table, keys in tables.items() for name in keys)}
    return {name: value for name, value in plain.items() if name not in own}
