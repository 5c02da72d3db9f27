"""The tables of a run as pandas frames."""

from __future__ import annotations

import importlib.util
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl


def to_pandas(**tables: pl.DataFrame) -> dict[str, pd.DataFrame]:
    """Return the same tables, by name, as pandas frames; empty values are NaN.

    Raises ImportError if pandas is not installed.
    """
    if importlib.util.find_spec("pandas") is None:
        raise ImportError("to_pandas needs the package pandas: pip install 'murmur-robots[pandas]'")
    return {name: table.to_pandas() for name, table in tables.items()}
