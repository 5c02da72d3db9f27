"""Temporary directories of processes that were killed are removed by the next process that makes one."""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path

import pytest

from protocol.temporary import temporary_folder

HOLD = """
from protocol.temporary import temporary_folder
with temporary_folder() as folder:
    (folder / "file").touch()
    print(folder, flush=True)
    input()
"""


@pytest.fixture(autouse=True)
def _temporary_directory_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))


def test_directory_is_removed_at_the_end(tmp_path: Path) -> None:
    with temporary_folder() as folder:
        assert folder.parent == tmp_path
    assert not list(tmp_path.iterdir())


def test_directory_of_a_killed_process_is_removed_and_that_of_a_running_one_stays(tmp_path: Path) -> None:
    others = tmp_path / "murmur-tmp-of-a-user"
    others.mkdir()
    with subprocess.Popen(
        [sys.executable, "-c", HOLD], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        held = Path(process.stdout.readline().strip())
        with temporary_folder():
            assert held.exists()
        process.kill()
    with temporary_folder() as folder:
        assert set(tmp_path.iterdir()) == {others, folder}


def test_without_a_directory_for_temporary_files_the_error_says_how_to_name_one() -> None:
    code = """
from protocol.temporary import make_folder
try:
    make_folder()
except ValueError as error:
    print(error)
"""
    done = subprocess.run(
        [sys.executable, "-c", code],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0)),  # no file can be written
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert (
        "no directory for temporary files can be written: set the environment variable TMPDIR" in done.stdout
    )
