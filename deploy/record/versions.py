"""What a digest depends on besides the scenario: the versions of Python and of the packages that robots run on."""

from __future__ import annotations

import importlib.metadata
import platform
from functools import cache

PACKAGES = ("murmur-robots", "eclipse-zenoh", "numba", "numpy", "scipy")


def versions() -> dict[str, str]:
    """What a digest depends on besides the scenario."""
    return {"python": platform.python_version()} | {package: _version(package) for package in PACKAGES}


@cache
def _version(package: str) -> str:
    """The version that is installed; it takes a millisecond to find."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"
