"""Import of numba, only where kernels are compiled or read from its cache."""

from __future__ import annotations

import importlib
import os
import sys
from functools import cache
from pathlib import Path
from typing import Any


def check_compiler() -> None:
    """Raise ValueError if the environment forbids numba to compile."""
    if os.environ.get("NUMBA_DISABLE_JIT", "0").strip() not in ("", "0"):
        raise ValueError(
            "NUMBA_DISABLE_JIT is set, but kernels must be compiled: unset this environment variable"
        )


def user_cache() -> str:
    """Return the user's cache directory; empty if the user has no home directory.

    A relative or empty XDG_CACHE_HOME is ignored, as its specification says.
    """
    for place in (os.environ.get("XDG_CACHE_HOME", ""), os.path.expanduser("~/.cache")):  # noqa: PTH111  Path raises without a home
        if Path(place).is_absolute():
            return place
    return ""


@cache
def import_numba() -> Any:
    """Import numba without scipy.linalg, which takes 18 MB, and which only np.cov and np.corrcoef need in kernels.

    numba's cache never is in the working directory: without a home directory, numba would make one named ``~`` there.
    """
    if os.environ.get("XDG_CACHE_HOME") or not user_cache():
        os.environ["XDG_CACHE_HOME"] = user_cache() or os.devnull
    else:
        os.environ.pop("XDG_CACHE_HOME", None)  # it may be empty
    import numba  # noqa: PLC0415  takes half a second, which only computing commands need

    linear_algebra = "scipy.linalg"
    if linear_algebra not in sys.modules:
        sys.modules[linear_algebra] = None  # type: ignore[assignment] # so its import fails
        try:
            importlib.import_module("numba.np.arraymath")
        finally:
            del sys.modules[linear_algebra]
    return numba
