"""Exploration strategies, one file a paper; found by name among the subclasses of `Strategy`.

A new strategy is one new file here, a class in any importable module, named ``package.module:Class``, or an entry point
of an installed package (`agent.plugins`).
"""

from __future__ import annotations

import importlib
import pkgutil
from inspect import isabstract
from typing import Any

import agent.strategies
from agent.plugins import Plugins
from agent.strategies.base import Strategy


def strategies() -> dict[str, type[Strategy]]:
    """All strategies that have been imported and are complete, by name."""
    found: dict[str, type[Strategy]] = {}
    queue: list[Any] = [Strategy]
    while queue:
        for kind in queue.pop().__subclasses__():
            queue.append(kind)
            if "name" in vars(kind) and not isabstract(kind):
                found[kind.name] = kind
    return dict(sorted(found.items()))


PLUGINS: Plugins[Strategy] = Plugins("strategy", "murmur.strategies", Strategy)  # type: ignore[type-abstract]
"""Those that are not ours."""


def strategy(name: str) -> type[Strategy]:
    """Return the strategy called `name`: one of ours, of an installed package, or ``package.module:Class``.

    Raises
    ------
    ValueError
        There is none of that name (near names and those there are follow), or the class cannot be imported.
    """
    return PLUGINS.find(name, strategies())


for _module in pkgutil.iter_modules(agent.strategies.__path__):
    importlib.import_module(f"agent.strategies.{_module.name}")
