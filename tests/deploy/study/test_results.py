"""The table of runs: whole or not at all, in one order, of one writer."""

from __future__ import annotations

import errno
import resource
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from deploy.study import results
from deploy.study.results import Results, write_table


def row(key: str, seed: int, **more: Any) -> dict[str, Any]:
    return {"key": key, "code": "c", "error": None, "seed": seed, "explored": [0.5, 1.0], **more}


def test_a_table_does_not_depend_on_the_order_of_its_runs(tmp_path: Path) -> None:
    files = []
    for name, order in (("a", (2, 0, 1)), ("b", (1, 2, 0))):
        files.append(tmp_path / f"{name}.parquet")
        with Results(files[-1]) as table:
            for seed in order:
                kinds = {"bytes.rm": 3} if seed == 1 else {}
                table.add(row(f"k{seed}", seed, **kinds, steps=seed if seed else None))
    first, second = map(pl.read_parquet, files)
    assert first.equals(second) and first["seed"].to_list() == [0, 1, 2]


def test_tables_joined_as_in_the_docs_are_a_table(tmp_path: Path) -> None:
    """As in docs/experiments.md, The table of runs."""
    files = [tmp_path / "mine.parquet", tmp_path / "theirs.parquet"]
    for file, seeds, more in zip(files, ((0, 1), (1, 2)), ({}, {"bytes.rm": 3}), strict=True):
        with Results(file) as table:
            for seed in seeds:
                table.add(row(f"k{seed}", seed, **more))
    joined = pl.concat(map(pl.read_parquet, files), how="diagonal_relaxed").unique("key", maintain_order=True)
    joined.write_parquet(tmp_path / "both.parquet")
    with Results(tmp_path / "both.parquet") as table:
        assert all(table.knows(f"k{seed}", "c") for seed in range(3))
        table.add(row("k3", 3))
    assert results.read(tmp_path / "both.parquet")["seed"].to_list() == [0, 1, 2, 3]


def test_runs_are_on_the_disk_before_the_table_is_closed(tmp_path: Path) -> None:
    file = tmp_path / "a.parquet"
    with Results(file) as table:
        assert len(pl.read_parquet(file)) == 0
        table._took = 0
        table.add(row("k", 0))
        assert len(pl.read_parquet(file)) == 1
        table.add(row("k", 0, steps=3))
    assert pl.read_parquet(file)["steps"].to_list() == [3]


def test_columns_that_only_later_runs_have_are_null_in_earlier_rows_and_lists_may_be_missing(
    tmp_path: Path,
) -> None:
    file = tmp_path / "a.parquet"
    failed = {"key": "b", "code": "c", "error": "it fell over", "seed": 1}
    with Results(file) as table:
        table.add(row("a", 0))
    with Results(file) as table:
        table.add(failed)
        assert not table.knows("b", "c", retry=True) and table.knows("b", "c")
        assert table.rows(["a", "b"])["b"]["error"] == "it fell over"
        assert table.series("explored", ["a", "b"]) == {"a": [0.5, 1.0]}


def test_a_table_that_another_process_has_open_is_rejected(tmp_path: Path) -> None:
    file = tmp_path / "a.parquet"
    with Results(file), pytest.raises(ValueError, match="another process is adding runs"):
        Results(file)
    with Results(file):
        pass


def test_a_link_to_a_table_is_the_table(tmp_path: Path) -> None:
    file, link = tmp_path / "a.parquet", tmp_path / "link.parquet"
    link.symlink_to(file)
    with Results(file), pytest.raises(ValueError, match="another process is adding runs"):
        Results(link)
    with Results(link) as table:
        table.add(row("a", 0))
    assert link.is_symlink() and len(pl.read_parquet(file)) == 1


def test_a_loop_of_links_is_rejected(tmp_path: Path) -> None:
    link = tmp_path / "link.parquet"
    link.symlink_to(link)
    with pytest.raises(ValueError, match=r"link\.parquet: Too many levels of symbolic links; name a file"):
        Results(link)


@pytest.mark.parametrize("content", [b"", b"notes", b"PAR1 and no more"])
def test_a_file_that_is_no_table_is_rejected_and_not_changed(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "notes.txt"
    file.write_bytes(content)
    with pytest.raises(
        ValueError, match="is damaged, changed by another program, or not a Parquet file; restore"
    ):
        Results(file)
    assert file.read_bytes() == content


def test_another_table_is_rejected(tmp_path: Path) -> None:
    file = tmp_path / "steps.parquet"
    pl.DataFrame({"step": [1]}).write_parquet(file)
    with pytest.raises(ValueError, match="is not a table of runs; name a new file"):
        Results(file)


def test_a_table_with_other_types_is_refused_and_not_changed(tmp_path: Path) -> None:
    file = tmp_path / "old.parquet"
    old = pl.DataFrame([row("a", 0)], schema_overrides={"error": pl.String})
    old.with_columns(key=1).write_parquet(file)
    with pytest.raises(ValueError, match="is not a table of runs; name a new file"):
        Results(file)
    for value, kind in ((1.0, "Float64"), ("much", "String"), ({"a": 1}, "Struct.*")):
        old.with_columns(explored=pl.lit(value)).write_parquet(file)
        before = file.read_bytes()
        message = (
            rf"column explored has values of the type {kind}, but new runs have List\(Float64\); .* new file"
        )
        with pytest.raises(ValueError, match=message), Results(file) as table:
            table.add(row("b", 1))
        assert file.read_bytes() == before


def test_a_file_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    for file in (tmp_path / "missing" / "a.parquet", tmp_path):
        with pytest.raises(ValueError, match=r"name a (new )?file"):
            Results(file)


def test_the_file_extension_selects_the_table_format(tmp_path: Path) -> None:
    frame = pl.DataFrame({"a": [1, 2]})
    for ending, reader in ((".csv", pl.read_csv), (".parquet", pl.read_parquet)):
        results.write_table(frame, tmp_path / f"t{ending}")
        assert reader(tmp_path / f"t{ending}").equals(frame)
    with pytest.raises(ValueError, match=r"t\.txt: must end in \.csv or \.parquet"):
        results.write_table(frame, tmp_path / "t.txt")


@pytest.mark.parametrize("name", ["a.parquet", "a.csv"])
def test_a_full_disk_is_an_error_of_the_disk_and_leaves_the_last_table(tmp_path: Path, name: str) -> None:
    file = tmp_path / name
    write_table(pl.DataFrame({"a": [1]}), file)
    before = file.read_bytes()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
    try:
        with pytest.raises(OSError, match=name) as caught:
            write_table(pl.DataFrame({"a": range(100_000)}), file)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert (caught.value.errno, file.read_bytes()) == (errno.EFBIG, before)
    assert [each.name for each in tmp_path.iterdir()] == [name]
