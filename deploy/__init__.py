"""The laboratory, and Murmur from Python.

``result = explore(Scenario(robots=5))`` runs a scenario to its end, ``for step in steps(robots=5): ...`` one step after
the other.

Rooms, each of which may import those before it: `scenario`, `record`, `dashboard`, `run`; `after`, `study`, `chaos`
and `bench`, which are independent of each other; `commands`. Start with `run/exploration.py`, one run from its
scenario to its directory.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from deploy.run.exploration import Result, explore
    from deploy.run.stepwise import Step, Steps, steps
    from deploy.scenario.scenario import Scenario
    from deploy.study.comparison import compare
    from deploy.study.sizing import size
    from deploy.study.sweep import sweep

_HOMES = {
    "Result": "deploy.run.exploration",
    "Scenario": "deploy.scenario.scenario",
    "Step": "deploy.run.stepwise",
    "Steps": "deploy.run.stepwise",
    "compare": "deploy.study.comparison",
    "explore": "deploy.run.exploration",
    "size": "deploy.study.sizing",
    "steps": "deploy.run.stepwise",
    "sweep": "deploy.study.sweep",
}
"""Public names, and where they are defined."""

__all__ = ["Result", "Scenario", "Step", "Steps", "compare", "explore", "size", "steps", "sweep"]


def __getattr__(name: str) -> Any:
    """Import a public name on first access: robots import this package too and need none of them."""
    import importlib  # noqa: PLC0415

    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)
