"""What a digest depends on besides the scenario: the versions of Python and of the packages that robots run on."""

from __future__ import annotations

import importlib.metadata
import platform

PACKAGES = ("murmur-robots", "eclipse-zenoh", "numba", "numpy", "scipy")


def versions() -> dict[str, str]:
    """What a digest depends on besides the scenario."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            found[package] = "not installed"
    return found
