"""The tables of a run as pandas frames."""

from __future__ import annotations

from typing import TYPE_CHECKING

from protocol.packages import require

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl


def to_pandas(**tables: pl.DataFrame) -> dict[str, pd.DataFrame]:
    """Return the same tables, by name, as pandas frames; empty values are NaN.

    Raises MissingPackageError, an ImportError, if pandas is not installed.
    """
    require("pandas", "pandas", "to_pandas needs")
    return {name: table.to_pandas() for name, table in tables.items()}
