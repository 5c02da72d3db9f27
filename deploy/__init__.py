"""The laboratory, and Murmur from Python: ``result = explore(Scenario(robots=5))``.

Rooms, each of which may import those before it: `scenario`, `record`, `dashboard`, `run`; `after`, `study` and `bench`,
which are independent of each other; `commands`. Start with `run/exploration.py`, one run from its scenario to its
directory.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from deploy.run.exploration import Result, explore
    from deploy.scenario.scenario import Scenario
    from deploy.study.comparison import compare
    from deploy.study.sizing import size
    from deploy.study.sweep import sweep

__all__ = ["Result", "Scenario", "compare", "explore", "size", "sweep"]

_HOMES = {
    "Scenario": "deploy.scenario.scenario",
    "Result": "deploy.run.exploration",
    "explore": "deploy.run.exploration",
    "compare": "deploy.study.comparison",
    "size": "deploy.study.sizing",
    "sweep": "deploy.study.sweep",
}


def __getattr__(name: str) -> Any:
    """Import a public name on first access: robots import this package too and need none of them."""
    import importlib  # noqa: PLC0415

    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)
