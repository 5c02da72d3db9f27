"""The directory of a run."""

from __future__ import annotations

import errno
import resource
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.encodings.none import NoEncoding
from deploy.record import run_directory
from deploy.scenario import plan as plans
from deploy.scenario.scenario import parse
from murmur import explore
from protocol.grid import OCCUPIED


@pytest.mark.parametrize("exists", [False, True])
def test_a_directory_is_free_again_after_a_full_disk(tmp_path: Path, exists: bool) -> None:
    out = tmp_path / "run"
    if exists:
        out.mkdir()
    plan = plans.make(parse({"map": "leader-rooms"}))
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))  # room for the map only
    try:
        with pytest.raises(OSError, match=run_directory.SCENARIO) as caught:
            run_directory.create(out, plan)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert caught.value.errno == errno.EFBIG
    assert out.exists() == exists
    run_directory.create(out, plan)
    assert (out / run_directory.SCENARIO).is_file()


class Walls(NoEncoding):
    """An encoding with a mistake: it changes the grids."""

    name = "walls"

    def merge(self, own: Any, peers: Any = ()) -> Any:
        own[:] = OCCUPIED
        return np.full_like(own, OCCUPIED)


def test_a_run_is_written_without_the_maps_that_have_no_free_cell(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = explore(map="leader-rooms", robots=1, steps=2, map_encoding=Walls, bus="memory")
    assert result.directory is not None
    assert ":" not in result.directory.name
    files = {file.name for file in result.directory.iterdir()}
    assert {"summary.json", "steps.parquet", "maps.png"} <= files
    assert not any(name.startswith(("planning-", "team")) for name in files)
