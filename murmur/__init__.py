"""Murmur from Python: run a swarm of exploring robots, step through a run, compare runs.

``murmur.explore(robots=5)`` runs a scenario to its end, ``for step in murmur.steps(robots=5): ...`` one step at a time.
``sweep``, ``compare`` and ``size`` repeat runs over seeds and settings. ``read_run`` reads a run directory, ``merge``
joins records of robots in the field, and `murmur.gym` has environments for learning. Everything else is in the packages
`deploy` (running and recording), `agent` (the robot), `worldsim` (the world), `netshaper` (the radio) and `protocol`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from deploy.after.merge import merge
    from deploy.after.recorded_run import read_run
    from deploy.run.exploration import explore
    from deploy.run.failure import RunFailed
    from deploy.run.result import Result
    from deploy.run.stepwise import Step, Steps, steps
    from deploy.scenario.errors import ScenarioError
    from deploy.scenario.scenario import Scenario, load
    from deploy.study.comparison import compare
    from deploy.study.radio_sizing import size_radios
    from deploy.study.sizing import size
    from deploy.study.sweep import sweep

__all__ = [
    "Result", "RunFailed", "Scenario", "ScenarioError", "Step", "Steps", "compare", "explore", "load", "merge",
    "read_run", "size", "size_radios", "steps", "sweep",
]  # fmt: skip

_MODULES = {
    "Result": "deploy.run.result",
    "RunFailed": "deploy.run.failure",
    "Scenario": "deploy.scenario.scenario",
    "ScenarioError": "deploy.scenario.errors",
    "Step": "deploy.run.stepwise",
    "Steps": "deploy.run.stepwise",
    "compare": "deploy.study.comparison",
    "explore": "deploy.run.exploration",
    "load": "deploy.scenario.scenario",
    "merge": "deploy.after.merge",
    "read_run": "deploy.after.recorded_run",
    "size": "deploy.study.sizing",
    "size_radios": "deploy.study.radio_sizing",
    "steps": "deploy.run.stepwise",
    "sweep": "deploy.study.sweep",
}
"""The module that defines each public name."""


def __getattr__(name: str) -> Any:
    """Import a public name on first access, so that `import murmur` takes milliseconds rather than seconds."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    """The public names, for `help` and for completion in an interactive session."""
    return __all__
