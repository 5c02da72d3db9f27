"""Exploration strategies, one file a paper; found by name among the subclasses of `Strategy`.

A new strategy is one new file here, or a class in any importable module, named ``package.module:Class``.
"""

from __future__ import annotations

import importlib
import pkgutil
import sys
import traceback
from pathlib import Path
from typing import Any

import agent.strategies
from agent.strategies.base import Strategy
from protocol.errors import there_are


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
        raise ValueError(
            f"no strategy is called {name!r}; {there_are(known, name)}; or give one as package.module:Class"
        )
    return known[name]


def _imported(name: str) -> type[Strategy]:
    module_name, _, class_name = name.partition(":")
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)  # last: a file here that is called as one of ours hides nothing
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module_name}.".startswith(f"{error.name}."):
            raise ValueError(f"strategy {name!r} cannot be imported:\n{traceback.format_exc()}") from None
        raise ValueError(
            f"strategy {name!r}: {error}; a module is looked for in this folder and on PYTHONPATH"
        ) from None
    except Exception:
        raise ValueError(f"strategy {name!r} cannot be imported:\n{traceback.format_exc()}") from None
    kind = getattr(module, class_name, None)
    if not isinstance(kind, type) or not issubclass(kind, Strategy) or "name" not in vars(kind):
        raise ValueError(
            f"strategy {name!r}: {class_name} is no subclass of agent.strategies.Strategy with a name"
        )
    return kind


for _module in pkgutil.iter_modules(agent.strategies.__path__):
    importlib.import_module(f"agent.strategies.{_module.name}")
