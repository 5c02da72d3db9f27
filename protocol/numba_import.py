"""Import of numba, only where kernels are compiled or read from its cache."""

from __future__ import annotations

import importlib
import os
import sys
from functools import cache
from typing import Any


def check_compiler() -> None:
    """Raise ValueError if the environment forbids numba to compile."""
    if os.environ.get("NUMBA_DISABLE_JIT", "0").strip() not in ("", "0"):
        raise ValueError(
            "NUMBA_DISABLE_JIT is set, but kernels must be compiled: unset this environment variable"
        )


@cache
def import_numba() -> Any:
    """Import numba without scipy.linalg, which takes 18 MB, and which only np.cov and np.corrcoef need in kernels."""
    import numba  # noqa: PLC0415  takes half a second, which only computing commands need

    linear_algebra = "scipy.linalg"
    if linear_algebra not in sys.modules:
        sys.modules[linear_algebra] = None  # type: ignore[assignment] # so its import fails
        try:
            importlib.import_module("numba.np.arraymath")
        finally:
            del sys.modules[linear_algebra]
    return numba
