"""Import of numba, only where kernels are compiled or read from its cache."""

from __future__ import annotations

import importlib
import sys
from functools import cache
from typing import Any


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
