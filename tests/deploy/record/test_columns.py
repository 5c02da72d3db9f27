"""The described columns are those of the files."""

from __future__ import annotations

from pyarrow import parquet

from deploy.record.columns import FILES
from netshaper.ledger import CAUSES, ROW
from tests.deploy.small_run import small_directory


def test_each_file_has_the_described_columns() -> None:
    for name, columns in FILES.items():
        schema = parquet.read_schema(small_directory() / name)
        assert [(field.name, str(field.type)) for field in schema] == [
            (column.name, column.type) for column in columns
        ]


def test_the_relay_writes_the_described_ledger() -> None:
    assert [column.name for column in FILES["ledger.parquet"]] == list(ROW.names or ())
    assert CAUSES[0] == ""
