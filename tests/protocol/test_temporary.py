"""Temporary directories of processes that were killed are removed by the next process that makes one."""

from __future__ import annotations

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
