"""Settings for the thesis' plain rules, without our improvements of them."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from agent.encodings.options import THESIS_OPTIONS, PolygonOptions
from deploy.scenario.scenario import SHIPPED, Scenario, ScenarioError, load, read_toml

ENCODING, DISSEMINATIONS, STRATEGY = "polygons", "thesis", "meier"

PLAIN_OPTIONS: dict[str, dict[str, Any]] = {"meier": {"herding": False}}
"""Strategy options that switch off our additions: the rule against herding is not in the thesis."""


def thesis_settings(strategy: str = STRATEGY) -> dict[str, Any]:
    """Return the settings for the thesis' plain rules, as overrides for `deploy.scenario.scenario.load`.

    `strategy` defaults to the thesis' own.
    """
    ours = asdict(PolygonOptions())
    plain = {name: value for name, value in asdict(THESIS_OPTIONS).items() if value != ours[name]}
    return (
        {"map_encoding": ENCODING, "dissemination": DISSEMINATIONS, "strategy": strategy}
        | {f"polygons.{name}": value for name, value in plain.items()}
        | {f"options.{name}": value for name, value in PLAIN_OPTIONS.get(strategy, {}).items()}
    )


def load_by_thesis(path: Path | None, overrides: dict[str, Any]) -> Scenario:
    """Load a scenario as `deploy.scenario.scenario.load` does, with the thesis' plain rules as further overrides.

    The given overrides take precedence, and so does the file's strategy.
    """
    in_file = {} if path is None else read_toml(path, "scenario", SHIPPED)[1]
    given = {name: value for name, value in overrides.items() if value is not None}
    own = {*given, *(f"options.{name}" for name in given.get("options", {}))}
    plain = thesis_settings(str(given.get("strategy", in_file.get("strategy", STRATEGY))))
    return load(path, given | {name: value for name, value in plain.items() if name not in own})


def with_thesis(data: dict[str, Any], where: str) -> dict[str, Any]:
    """Replace ``thesis = true`` by the thesis' plain rules; settings that `data` gives itself take precedence.

    Raises ScenarioError if `thesis` is neither true nor false; the message begins with `where`.
    """
    asked, data = data.get("thesis", False), {key: value for key, value in data.items() if key != "thesis"}
    if not isinstance(asked, bool):
        raise ScenarioError(f"{where}: thesis = {asked!r}: must be true or false")
    for key, value in thesis_settings(data.get("strategy", STRATEGY)).items() if asked else ():
        table, dot, inner = key.partition(".")
        data[table] = {inner: value, **data.get(table, {})} if dot else data.get(table, value)
    return data
