"""The directory in which the fork server listens."""

from __future__ import annotations

from pathlib import Path

import pytest

from deploy.run import parent_watchdog


def test_a_long_temporary_directory_is_refused_if_the_usual_one_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    long = tmp_path / ("long" * 20)
    long.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(long))
    monkeypatch.setattr(parent_watchdog, "USUAL", str(tmp_path / "missing"))
    with pytest.raises(ValueError, match=r"has more than 45 characters.* name a shorter directory") as caught:
        parent_watchdog.open_folder.__wrapped__()
    assert f"TMPDIR = {long}: " in str(caught.value) and "No such file or directory" in str(caught.value)
