"""Exploration strategies, one file a paper's idea; found by name among the subclasses of `Strategy`."""

from __future__ import annotations

from agent.strategies.base import Situation, Strategy
from agent.strategies.meier import Meier

__all__ = ["Meier", "Situation", "Strategy", "strategies", "strategy"]


def strategies() -> dict[str, type[Strategy]]:
    """All strategies that have been imported, by name."""
    found: dict[str, type[Strategy]] = {}
    queue = [Strategy]
    while queue:
        for kind in queue.pop().__subclasses__():
            queue.append(kind)
            if "name" in vars(kind):
                found[kind.name] = kind
    return dict(sorted(found.items()))


def strategy(name: str) -> type[Strategy]:
    """Return the strategy called `name`; ValueError lists the names there are."""
    known = strategies()
    if name not in known:
        raise ValueError(f"no strategy is called {name!r}; there are: {', '.join(known)}")
    return known[name]
