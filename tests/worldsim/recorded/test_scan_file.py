from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.worldsim.recorded.made_logs import write_carmen
from worldsim.recorded import scan_file
from worldsim.recorded.log import LogError
from worldsim.recorded.reading import read


def arrays(folder: Path) -> dict[str, Any]:
    scan_file.write(read(write_carmen(folder / "room.log", scans=6)), folder / "a.npz")
    with np.load(folder / "a.npz") as archive:
        return dict(archive)


def test_a_log_that_is_written_is_read_to_the_bit(tmp_path: Path) -> None:
    log = read(write_carmen(tmp_path / "room.log", scans=6))
    scan_file.write(log, tmp_path / "a.npz")
    again = read(tmp_path / "a.npz")
    assert (again.name, again.angles) == (log.name, log.angles)
    for name in ("poses", "ranges", "stamps"):
        assert (getattr(again, name) == getattr(log, name)).all()
        assert getattr(again, name).dtype == getattr(log, name).dtype
    assert read(tmp_path / "a.npz", every=4).stamps.tolist() == log.stamps[::4].tolist()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("name", "../elsewhere"),
        ("name", ""),
        ("angles", [0, -5]),
        ("poses", np.zeros((6, 2))),
        ("poses", np.full((6, 3), np.nan)),
        ("poses", np.zeros((6, 3), int)),
        ("ranges", np.zeros((5, 181), np.uint16)),
        ("stamps", np.zeros(3)),
    ],
)
def test_arrays_that_are_no_scans_are_refused(tmp_path: Path, name: str, value: Any) -> None:
    found = arrays(tmp_path) | {name: np.array(value)}
    np.savez(tmp_path / "wrong.npz", **found)
    with pytest.raises(LogError, match="wrong.npz: not the scans of a run: " + name):
        read(tmp_path / "wrong.npz")


def test_a_missing_array_is_named(tmp_path: Path) -> None:
    found = arrays(tmp_path)
    del found["stamps"]
    np.savez(tmp_path / "wrong.npz", **found)
    with pytest.raises(LogError, match=r"wrong.npz: not the scans of a run: .*stamps"):
        read(tmp_path / "wrong.npz")
