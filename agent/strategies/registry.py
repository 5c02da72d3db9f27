"""Find a strategy by its name, among the imported subclasses of `Strategy` and the plugins.

A new strategy is one new file here, a class in any importable module, named ``package.module:Class``, or an entry point
of an installed package (`agent.plugins`).
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping
from inspect import isabstract
from typing import Any

import agent.strategies
from agent.plugins import Plugins
from agent.strategies.base import Strategy


def strategies() -> dict[str, type[Strategy]]:
    """Return all imported exploration strategies without abstract methods, by name."""
    return {name: kind for name, kind in all_strategies().items() if kind.explores}


def all_strategies() -> dict[str, type[Strategy]]:
    """Return the same, and strategies of robots that do not explore."""
    found: dict[str, type[Strategy]] = {}
    queue: list[Any] = [Strategy]
    while queue:
        for kind in queue.pop().__subclasses__():
            queue.append(kind)
            if "name" in vars(kind) and not isabstract(kind):
                found[kind.name] = kind
    return dict(sorted(found.items()))


class _Unloaded(Strategy):
    """Any strategy of another package, where a run is read without importing its code."""

    @classmethod
    def check(cls, options: Mapping[str, Any]) -> Any:
        return options


PLUGINS: Plugins[Strategy] = Plugins("strategy", "murmur.strategies", Strategy, _Unloaded)  # type: ignore[type-abstract]
"""The strategies of installed packages."""


def strategy(name: str) -> type[Strategy]:
    """Return the strategy with this name, of this or an installed package, or given as ``package.module:Class``.

    ValueError: the name is unknown (the message lists similar names), or the class cannot be imported.
    """
    return all_strategies().get(name) or PLUGINS.find(name, strategies())


for _module in pkgutil.iter_modules(agent.strategies.__path__):
    importlib.import_module(f"agent.strategies.{_module.name}")
