"""The described columns are those of the files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pyarrow import Table, parquet

from deploy.record import missed_phases
from deploy.record.columns import FILES
from deploy.record.missed_phases import MISSED
from deploy.scenario.errors import ScenarioError
from netshaper.ledger import CAUSES, ROW
from protocol.messages import Missed
from tests.deploy.small_run import small_directory


def test_each_file_has_the_described_columns(tmp_path: Path) -> None:
    missed_phases.write(tmp_path / MISSED, [])
    for name, columns in FILES.items():
        schema = parquet.read_schema((tmp_path if name == MISSED else small_directory()) / name)
        assert [(field.name, str(field.type)) for field in schema] == [
            (column.name, column.type) for column in columns
        ]


def test_each_column_has_values(tmp_path: Path) -> None:
    missed_phases.write(tmp_path / MISSED, [Missed(1, "offers", 1, [0])])
    for name in FILES:
        rows = parquet.read_table((tmp_path if name == MISSED else small_directory()) / name)
        assert [each for each in rows.column_names if rows[each].null_count == len(rows)] == []


def test_the_relay_writes_the_described_ledger() -> None:
    assert [column.name for column in FILES["ledger.parquet"]] == list(ROW.names or ())
    assert CAUSES[0] == ""


def test_missed_phases_are_read_as_they_were_written(tmp_path: Path) -> None:
    record = [Missed(1, "offers", 1, [0, 2]), Missed(1, "move", 0, [2]), Missed(2, "step", 0, [2])]
    missed_phases.write(tmp_path / MISSED, record)
    assert missed_phases.read(tmp_path / MISSED, 3) == record


def test_a_damaged_or_missing_record_of_missed_phases_is_named(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="is missing"):
        missed_phases.read(tmp_path / MISSED, 3)
    (tmp_path / MISSED).write_bytes(b"PAR1")
    with pytest.raises(ScenarioError, match="damaged table"):
        missed_phases.read(tmp_path / MISSED, 3)
    parquet.write_table(parquet.read_table(small_directory() / "steps.parquet"), tmp_path / MISSED)
    with pytest.raises(ScenarioError, match="damaged table"):
        missed_phases.read(tmp_path / MISSED, 3)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"phase": "lunch"}, "unknown phase, 'lunch'"),
        ({"robot": 3}, "robot 3 of 3 robots"),
        ({"robot": -1}, "damaged table"),
        ({"step": [1]}, "damaged table"),
        ({"step": None}, "damaged table"),
        ({"phase": b"\xff"}, "damaged table"),
    ],
)
def test_a_record_that_no_run_can_have_is_refused(
    tmp_path: Path, change: dict[str, Any], problem: str
) -> None:
    row = {"step": 1, "phase": "move", "round": 0, "robot": 2} | change
    parquet.write_table(Table.from_pylist([row]), tmp_path / MISSED)
    with pytest.raises(ScenarioError, match=problem):
        missed_phases.read(tmp_path / MISSED, 3)
