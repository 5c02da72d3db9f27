from io import BytesIO
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.journal import MAX_RECORD, Journal

records = st.lists(st.binary(max_size=40), max_size=6)


@given(records)
def test_written_records_are_read_back(written: list[bytes]) -> None:
    file = BytesIO()
    journal = Journal(file)
    for record in written:
        journal.append(record)
    assert Journal(file).records == written == journal.records


@given(records, st.data())
def test_a_journal_cut_off_anywhere_keeps_all_records_before_and_goes_on(
    written: list[bytes], data: st.DataObject
) -> None:
    file = BytesIO()
    journal, ends = Journal(file), [0]
    for record in written:
        journal.append(record)
        ends.append(len(file.getvalue()))
    cut = data.draw(st.integers(0, ends[-1]))
    torn = BytesIO(file.getvalue()[:cut])
    whole = written[: sum(end <= cut for end in ends) - 1]
    again = Journal(torn)
    assert again.records == whole
    again.append(b"new")
    assert Journal(torn).records == [*whole, b"new"]


@given(st.binary(max_size=100))
def test_opening_any_bytes_truncates_them_to_whole_records(data: bytes) -> None:
    file = BytesIO(data)
    records = Journal(file).records
    assert data.startswith(file.getvalue())
    assert Journal(file).records == records


def test_a_changed_byte_ends_the_journal_before_its_record() -> None:
    file = BytesIO()
    for record in (b"one", b"two"):
        Journal(file).append(record)
    data = bytearray(file.getvalue())
    data[-1] ^= 1
    assert Journal(BytesIO(bytes(data))).records == [b"one"]


def test_a_journal_on_disk_is_made_and_reopened(tmp_path: Path) -> None:
    path = tmp_path / "journals" / "r0.journal"
    Journal.open(path).append(b"one")
    Journal.open(path).append(b"two")
    assert Journal.open(path).records == [b"one", b"two"]


def test_a_record_that_is_too_long_is_rejected() -> None:
    with pytest.raises(ValueError, match="is longer than"):
        Journal(BytesIO()).append(bytes(MAX_RECORD + 1))
