"""Commands on a finished run: replays, and errors on a full disk."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.deploy.commands.office_floor import explore, murmur


def test_a_replay_reports_whether_the_digest_is_equal(floor: str) -> None:
    explore(floor, "--steps", "8", "--out", "run")
    result = murmur("replay", "run")
    assert (result.exit_code, result.stdout[:14]) == (0, "Replay matches")
    found = json.loads(murmur("replay", "run", "--json").stdout)
    assert found["holds"]
    assert found["digest"] == found["before"]
    summary = json.loads(Path("run/summary.json").read_text())
    Path("run/summary.json").write_text(json.dumps(summary | {"digest": "0" * 64, "steps": 7}))
    result = murmur("replay", "run")
    assert result.exit_code == 1
    assert "Replay differs" in result.stderr
    assert "steps: was 7, is 8" in result.stderr


def test_a_replay_lists_changed_settings_first(floor: str) -> None:
    explore(floor, "--steps", "4", "--out", "run")
    scenario = Path("run/scenario.toml")
    scenario.write_text(scenario.read_text().replace("robots = 2", "robots = 3"))
    result = murmur("replay", "run")
    assert result.exit_code == 1
    assert result.stderr.splitlines()[1] == "  robots: was 2, is 3"
    assert "map: " not in result.stderr


@pytest.mark.parametrize(
    ("what", "why"),
    [
        ({"reason": "interrupted"}, "it was interrupted at step 4"),
        ({"reason": "broken off"}, "it was broken off at step 4"),
        ({"lost": {"1": "its process ended"}}, "robot 1 was lost: its process ended, unexpectedly"),
    ],
)
def test_a_run_with_unplanned_events_cannot_be_replayed(floor: str, what: dict[str, Any], why: str) -> None:
    explore(floor, "--steps", "4", "--out", "run")
    summary = json.loads(Path("run/summary.json").read_text())
    Path("run/summary.json").write_text(json.dumps(summary | what))
    result = murmur("replay", "run")
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr == f"murmur: run: cannot be repeated: {why}\n"


FULL_DISK = """
import resource, sys
from deploy.after import export, report
from deploy.commands.app import app
resource.setrlimit(resource.RLIMIT_FSIZE, (9000, resource.RLIM_INFINITY))
app(sys.argv[1:])
"""


@pytest.mark.parametrize("words", ["explore --map floor.yaml --bus memory --out two --json", "report run"])
def test_a_full_disk_is_named_with_the_file_and_ends_with_3(floor: str, words: str) -> None:
    explore(floor, "--steps", "30", "--out", "run")
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, *words.split()],
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[3])},
        capture_output=True,
        text=True,
        check=False,
    )
    last = done.stderr.splitlines()[-1]
    assert (done.returncode, done.stdout) == (3, ""), done.stderr
    assert last.startswith("murmur: ")
    assert last.endswith("File too large")
    assert "Traceback" not in done.stderr
    assert not list(Path("run").glob("pictures/*"))
