"""Packages that only the extras of Murmur install."""

from __future__ import annotations

import importlib.util


class MissingPackageError(ModuleNotFoundError, ValueError):
    """A package is not installed; the message says how to install it."""


def require(package: str, extra: str, need: str) -> None:
    """Raise MissingPackageError unless the top-level module `package` can be imported.

    `extra` is the extra of Murmur that installs it, and `need` the beginning of the message, as "films need".
    """
    if importlib.util.find_spec(package) is None:
        name = package.replace("_", "-")
        raise MissingPackageError(
            f"{need} the package {name}: pip install 'murmur-robots[{extra}]'", name=package
        )
