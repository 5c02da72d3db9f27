"""Exploration strategies, one file a paper; found by name among the subclasses of `Strategy`.

A new strategy is one new file here, or a class in any importable module, named ``package.module:Class``.
"""

from __future__ import annotations

import difflib
import importlib
import pkgutil
from typing import Any

import agent.strategies
from agent.strategies.base import Strategy


def strategies() -> dict[str, type[Strategy]]:
    """All strategies that have been imported, by name."""
    found: dict[str, type[Strategy]] = {}
    queue: list[Any] = [Strategy]
    while queue:
        for kind in queue.pop().__subclasses__():
            queue.append(kind)
            if "name" in vars(kind):
                found[kind.name] = kind
    return dict(sorted(found.items()))


def strategy(name: str) -> type[Strategy]:
    """Return the strategy called `name`, or the class that ``package.module:Class`` names.

    Raises
    ------
    ValueError
        There is none of that name (near names and those there are follow), or the class cannot be imported.
    """
    if ":" in name:
        return _imported(name)
    known = strategies()
    if name not in known:
        near = difflib.get_close_matches(name.lower(), known)
        meant = f"; did you mean {' or '.join(near)}? There are: " if near else "; there are: "
        raise ValueError(
            f"no strategy is called {name!r}{meant}{', '.join(known)}; or give one as package.module:Class"
        )
    return known[name]


def _imported(name: str) -> type[Strategy]:
    module_name, _, class_name = name.partition(":")
    try:
        module = importlib.import_module(module_name)
    except ImportError as error:
        raise ValueError(
            f"strategy {name!r}: {error}; is the folder of {module_name} on PYTHONPATH?"
        ) from None
    kind = getattr(module, class_name, None)
    if not isinstance(kind, type) or not issubclass(kind, Strategy) or "name" not in vars(kind):
        raise ValueError(
            f"strategy {name!r}: {class_name} is no subclass of agent.strategies.Strategy with a name"
        )
    return kind


for _module in pkgutil.iter_modules(agent.strategies.__path__):
    importlib.import_module(f"agent.strategies.{_module.name}")
