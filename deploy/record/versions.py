"""The versions that a digest depends on besides the scenario: Python and the packages of the robots."""

from __future__ import annotations

import importlib.metadata
import platform
from functools import cache

PACKAGES = ("murmur-robots", "eclipse-zenoh", "numba", "numpy", "scipy")


def versions() -> dict[str, str]:
    """The version of Python and of each package."""
    return {"python": platform.python_version()} | {package: _version(package) for package in PACKAGES}


@cache
def _version(package: str) -> str:
    """The installed version; the look-up takes a millisecond."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"
