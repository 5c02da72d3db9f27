"""Tables of runs with flipped bits are refused before Parquet is parsed, and other programs can read intact ones."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import polars as pl
import pyarrow.parquet
import pytest

from deploy.study import checked_parquet
from deploy.study.checked_parquet import DamagedError
from deploy.study.results import Results

FRAME = pl.DataFrame(
    {
        "key": [f"k{number:02}" for number in range(40)],
        "steps": np.arange(40) ** 2,
        "explored": [[0.01 * number] * 20 for number in range(40)],
    }
)


def test_each_flipped_bit_of_the_rows_and_the_footer_is_found_unless_the_table_stays_equal() -> None:
    """Only the key and two bytes after it can stay unnoticed: without them, the table is one of an earlier version."""
    data = checked_parquet.serialize(FRAME)
    found = 0
    random = np.random.default_rng(0)
    bits = [int(8 * byte + random.integers(8)) for byte in range(len(data))]
    for bit in bits:
        damaged = bytearray(data)
        damaged[bit // 8] ^= 1 << bit % 8
        try:
            read = checked_parquet.parse(bytes(damaged))
        except DamagedError:
            found += 1
        else:
            assert read.equals(FRAME), f"bit {bit}"
    assert found >= len(bits) - len(checked_parquet.KEY) - 2


def test_other_programs_read_the_table(tmp_path: Path) -> None:
    file = tmp_path / "a.parquet"
    file.write_bytes(checked_parquet.serialize(FRAME))
    assert pl.read_parquet(file).equals(FRAME)
    assert pl.DataFrame(pyarrow.parquet.read_table(file)).equals(FRAME)


def test_a_table_of_an_earlier_version_has_no_digest_and_is_read() -> None:
    buffer = io.BytesIO()
    FRAME.write_parquet(buffer)
    assert checked_parquet.parse(buffer.getvalue()).equals(FRAME)


def test_a_table_of_runs_with_a_flipped_bit_is_refused_and_stays_as_it_is(tmp_path: Path) -> None:
    file = tmp_path / "a.parquet"
    with Results(file) as table:
        for seed in range(20):
            table.add({"key": f"k{seed}", "code": "c", "error": None, "seed": seed, "steps": 100 + seed})
    damaged = bytearray(file.read_bytes())
    damaged[len(damaged) // 3] ^= 1
    file.write_bytes(damaged)
    with pytest.raises(ValueError, match=r"a\.parquet: is damaged, .*; restore a copy, remove it, or name"):
        Results(file)
    assert file.read_bytes() == damaged
