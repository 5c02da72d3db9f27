"""The strategies by name: those of this package, each a class in a module here, and plug-ins (`protocol.plugins`)."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator, Mapping
from inspect import isabstract
from typing import Any

import agent.strategies
from agent.strategies.base import Strategy
from protocol.plugins import Plugins


class _Unloaded(Strategy):
    """Any strategy of another package, where a run is read without importing its code."""

    @classmethod
    def check(cls, options: Mapping[str, Any]) -> Any:
        return options


STRATEGIES: dict[str, type[Strategy]] = {}
"""All strategies of this package by name, those of robots that do not explore included."""

PLUGINS: Plugins[type[Strategy]] = Plugins(
    "strategy", "murmur.strategies", Strategy, STRATEGIES, _Unloaded, unlisted=frozenset({"playback"})
)


def strategies() -> dict[str, type[Strategy]]:
    """Return the exploration strategies of this package, by name."""
    return {name: kind for name, kind in STRATEGIES.items() if kind.explores}


def strategy(name: str) -> type[Strategy]:
    """Return the strategy with this name, of this or an installed package, or given as ``package.module:Class``.

    ValueError: the name is unknown (the message lists similar names), or the class cannot be imported.
    """
    return PLUGINS.find(name)


def _of_modules() -> Iterator[type[Strategy]]:
    """Yield the strategies of all modules of this package; some of these import this module."""
    for module in pkgutil.iter_modules(agent.strategies.__path__):
        loaded = importlib.import_module(f"agent.strategies.{module.name}")
        for kind in vars(loaded).values():
            is_own = isinstance(kind, type) and kind.__module__ == loaded.__name__
            if is_own and issubclass(kind, Strategy) and "name" in vars(kind) and not isabstract(kind):
                yield kind


STRATEGIES.update((kind.name, kind) for kind in sorted(_of_modules(), key=lambda kind: kind.name))
