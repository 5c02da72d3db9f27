"""The thesis, pure: what of the defaults is not in it, and how a scenario goes without."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from agent.encodings.polygon_options import THESIS_OPTIONS, PolygonOptions
from deploy.scenario.scenario import SHIPPED, Scenario, ScenarioError, load, read_toml

ENCODING, DISSEMINATIONS, STRATEGY = "polygons", "thesis", "meier"

NOT_IN_IT: dict[str, dict[str, Any]] = {"meier": {"herding": False}}
"""Options of strategies that take away what the thesis does not have: the rule against herding is ours."""


def thesis_settings(strategy: str = STRATEGY) -> dict[str, Any]:
    """Settings with which a scenario goes by the thesis' plain rules, as `deploy.scenario.scenario.load` takes them.

    `strategy` is the one that is asked for; the thesis' own if none is.
    """
    ours = asdict(PolygonOptions())
    plain = {name: value for name, value in asdict(THESIS_OPTIONS).items() if value != ours[name]}
    return (
        {"map_encoding": ENCODING, "dissemination": DISSEMINATIONS, "strategy": strategy}
        | {f"polygons.{name}": value for name, value in plain.items()}
        | {f"options.{name}": value for name, value in NOT_IN_IT.get(strategy, {}).items()}
    )


def load_by_thesis(path: Path | None, overrides: dict[str, Any]) -> Scenario:
    """As `deploy.scenario.scenario.load`, by the thesis' plain rules where no override says otherwise.

    A strategy that the file asks for stays.
    """
    said = {} if path is None else read_toml(path, "scenario", SHIPPED)[1]
    given = {name: value for name, value in overrides.items() if value is not None}
    own = {*given, *(f"options.{name}" for name in given.get("options", {}))}
    plain = thesis_settings(str(given.get("strategy", said.get("strategy", STRATEGY))))
    return load(path, given | {name: value for name, value in plain.items() if name not in own})


def with_thesis(data: dict[str, Any], where: str) -> dict[str, Any]:
    """Settings of which ``thesis = true`` asks for the thesis' plain rules; what they say themselves stays.

    Raises
    ------
    ScenarioError
        `thesis` is neither true nor false; `where` names the settings.
    """
    asked, data = data.get("thesis", False), {key: value for key, value in data.items() if key != "thesis"}
    if not isinstance(asked, bool):
        raise ScenarioError(f"{where}: thesis = {asked!r}: must be true or false")
    for key, value in thesis_settings(data.get("strategy", STRATEGY)).items() if asked else ():
        table, dot, inner = key.partition(".")
        data[table] = {inner: value, **data.get(table, {})} if dot else data.get(table, value)
    return data
