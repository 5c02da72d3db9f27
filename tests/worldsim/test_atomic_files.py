"""Atomic writing: files appear complete or not at all, and errors name the file."""

from __future__ import annotations

import errno
from pathlib import Path
from typing import BinaryIO

import pytest

from worldsim.atomic_files import link_target, write_whole


def fill_the_disk(file: BinaryIO) -> None:
    file.write(b"half")
    raise OSError(errno.ENOSPC, "No space left on device")


def test_file_has_its_name_once_it_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"

    def write(file: BinaryIO) -> None:
        file.write(b"whole")
        assert not path.exists()

    write_whole(path, write)
    assert path.read_bytes() == b"whole"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("before", [None, b"before"])
def test_error_names_the_file_which_stays_unchanged(tmp_path: Path, before: bytes | None) -> None:
    path = tmp_path / "a.txt"
    if before is not None:
        path.write_bytes(before)
    with pytest.raises(OSError, match="No space left on device") as caught:
        write_whole(path, fill_the_disk)
    assert (caught.value.errno, caught.value.filename) == (errno.ENOSPC, str(path))
    assert [each.read_bytes() for each in tmp_path.iterdir()] == ([] if before is None else [before])


def test_error_names_the_file_where_its_temporary_name_can_neither_be_written_nor_removed(
    tmp_path: Path,
) -> None:
    path = tmp_path / ("a" * 255)  # no name may be longer, and the temporary file's would be
    with pytest.raises(OSError, match="File name too long") as caught:
        write_whole(path, lambda file: file.write(b"x"))
    assert caught.value.filename == str(path)


def test_error_for_a_missing_directory_names_the_file(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"nowhere/a\.txt"):
        write_whole(tmp_path / "nowhere" / "a.txt", lambda file: file.write(b"x"))


@pytest.mark.parametrize("exists", [True, False])
def test_link_remains_and_the_file_that_it_leads_to_is_written_in_its_directory(
    tmp_path: Path, exists: bool
) -> None:
    links, files = tmp_path / "links", tmp_path / "files"
    links.mkdir()
    files.mkdir()
    (links / "a.txt").symlink_to("b.txt")
    (links / "b.txt").symlink_to("../files/c.txt")
    if exists:
        (files / "c.txt").write_bytes(b"before")
    with pytest.raises(OSError, match="No space left on device") as caught:
        write_whole(links / "a.txt", fill_the_disk)
    assert caught.value.filename == str(links / "a.txt")
    assert [each.read_bytes() for each in files.iterdir()] == ([b"before"] if exists else [])

    def write(file: BinaryIO) -> None:
        assert Path(file.name).parent == files
        file.write(b"whole")

    write_whole(links / "a.txt", write)
    assert (files / "c.txt").read_bytes() == b"whole" and len(list(files.iterdir())) == 1
    assert (links / "a.txt").is_symlink() and len(list(links.iterdir())) == 2


def test_loop_of_links_is_an_error_that_names_the_first_of_them(tmp_path: Path) -> None:
    one, other = tmp_path / "one", tmp_path / "other"
    one.symlink_to(other)
    other.symlink_to(one)
    with pytest.raises(OSError, match="Too many levels of symbolic links") as caught:
        write_whole(one, lambda file: file.write(b"x"))
    assert caught.value.filename == str(one)
    assert one.is_symlink() and other.is_symlink()


def test_path_without_a_link_is_its_own_target(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.symlink_to(tmp_path)
    assert link_target(folder / "a.txt") == folder / "a.txt"
