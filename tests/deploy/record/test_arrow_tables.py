"""Arrow tables from arrays and lists: they equal what pyarrow makes of the values, without pandas."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deploy.record.arrow_tables import table
from deploy.record.columns import FILES, Column

VALUES: dict[str, st.SearchStrategy[Any]] = {
    "int16": st.integers(-(1 << 15), (1 << 15) - 1),
    "int32": st.integers(-(1 << 31), (1 << 31) - 1),
    "uint8": st.integers(0, 255),
    "double": st.floats(allow_nan=False),
    "bool": st.booleans(),
    "string": st.text(st.characters(codec="utf-8")),
    "binary": st.binary(),
}


def test_all_types_of_columns_are_tested() -> None:
    assert {column.type for columns in FILES.values() for column in columns} == set(VALUES)


@pytest.mark.parametrize("kind", VALUES)
@given(data=st.data())
def test_a_column_has_the_values_of_its_list(kind: str, data: st.DataObject) -> None:
    values = data.draw(st.lists(VALUES[kind] | st.none()))
    found = table({"a": values}, [Column("a", kind, "")])
    found.validate(full=True)
    assert found.equals(pa.table({"a": pa.array(values, pa.type_for_alias(kind))}))


def test_numpy_arrays_are_converted_to_the_type_of_their_column() -> None:
    columns = {
        "a": np.arange(6, dtype=np.uint32)[::2],
        "b": np.array([True, False, True]),
        "c": np.array(["x", "", "yz"]),
    }
    found = table(columns, [Column("c", "string", ""), Column("b", "bool", ""), Column("a", "int16", "")])
    found.validate(full=True)
    assert found.to_pydict() == {"c": ["x", "", "yz"], "b": [True, False, True], "a": [0, 2, 4]}


def test_pandas_is_not_imported() -> None:
    script = """
import sys
from deploy.record.arrow_tables import table
from deploy.record.columns import STEPS
table({column.name: [None] for column in STEPS}, STEPS)
assert "pyarrow" in sys.modules and "pandas" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", script], check=True)
