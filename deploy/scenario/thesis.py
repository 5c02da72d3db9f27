"""The thesis, pure: what of the defaults is not in it, and how a scenario goes without."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from agent.exchange.polygon_options import THESIS_OPTIONS, PolygonOptions

OFFERS = "thesis"

NOT_IN_IT: dict[str, dict[str, Any]] = {"meier": {"herding": False}}
"""Options of strategies that take away what the thesis does not have: the rule against herding is ours."""


def thesis_settings(strategy: str) -> dict[str, Any]:
    """Settings with which a scenario goes by the thesis' plain rules, as `deploy.scenario.scenario.load` takes them."""
    ours = asdict(PolygonOptions())
    plain = {name: value for name, value in asdict(THESIS_OPTIONS).items() if value != ours[name]}
    return (
        {"offers": OFFERS}
        | {f"polygon.{name}": value for name, value in plain.items()}
        | {f"options.{name}": value for name, value in NOT_IN_IT.get(strategy, {}).items()}
    )
