"""The directory of a run."""

from __future__ import annotations

import errno
import resource
from pathlib import Path

import pytest

from deploy.record import run_directory
from deploy.scenario import plan as plans
from deploy.scenario.scenario import parse


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
