"""Arrow tables from numpy arrays and lists, by the descriptions of their columns, and their files.

`pyarrow.array` imports pandas if it is installed, to look for its types. That takes longer than writing the tables of
most runs, so arrays are made of their buffers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deploy.record.columns import Column
from worldsim.atomic_files import write_whole

Values = NDArray[Any] | Sequence[Any]


def table(columns: Mapping[str, Values], described: Sequence[Column]) -> Any:
    """Return a `pyarrow.Table` with the `described` columns, in their order.

    Values are numpy arrays of numbers or booleans, or lists in which None stands for null; all of equal length.
    """
    import pyarrow as pa  # noqa: PLC0415  a tenth of a second

    types = [pa.type_for_alias(column.type) for column in described]
    arrays = [_array(columns[each.name], kind) for each, kind in zip(described, types, strict=True)]
    return pa.Table.from_arrays(arrays, names=[column.name for column in described])


def write_table(path: Path, table: Any, compression: str = "snappy") -> None:
    """Write a `pyarrow.Table` atomically as a parquet file; OSError if that fails."""
    from pyarrow import parquet  # noqa: PLC0415  half a second to import

    write_whole(path, lambda file: parquet.write_table(table, file, compression=compression))


def _array(values: Values, kind: Any) -> Any:
    import pyarrow as pa  # noqa: PLC0415

    known: Any = None
    if not isinstance(values, np.ndarray) and None in values:
        known = _bits([each is not None for each in values])
    if pa.types.is_string(kind) or pa.types.is_binary(kind):
        texts = [each.encode() if isinstance(each, str) else each or b"" for each in values]
        content = [np.cumsum([0, *map(len, texts)], dtype=np.int32), b"".join(texts)]
    elif pa.types.is_boolean(kind):
        content = [_bits(values)]
    else:
        numbers = values if known is None else [0 if each is None else each for each in values]
        content = [np.ascontiguousarray(numbers, kind.to_pandas_dtype())]
    buffers = [None if each is None else pa.py_buffer(each) for each in (known, *content)]
    return pa.Array.from_buffers(kind, len(values), buffers)


def _bits(values: Values) -> NDArray[np.uint8]:
    """Return booleans as Arrow stores them."""
    return np.packbits(np.asarray(values, np.bool_), bitorder="little")
