"""Commands on a finished run: replays, and errors on a full disk."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from deploy.record import run_directory
from deploy.run import exploration
from deploy.run.in_memory import MemoryRun
from deploy.run.launch import Outcome
from deploy.run.result import conclude
from deploy.scenario import plan as plans
from deploy.scenario.scenario import load, parse
from netshaper.capture import read
from netshaper.pcapng import Reader
from protocol import keys as names
from protocol import rights
from protocol.bus import Bus
from protocol.messages import MapPart
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


def test_a_replay_that_differs_names_inputs_that_have_changed(floor: str) -> None:
    explore(floor, "--steps", "4", "--seed", "7", "--out", "run")
    scenario = Path("run/scenario.toml")
    lines = scenario.read_text().splitlines(keepends=True)
    scenario.write_text("".join(lines[: next(n for n, line in enumerate(lines) if line.startswith("steps"))]))
    result = murmur("replay", "run")
    assert result.exit_code == 1
    assert result.stderr.splitlines()[-1] == "  run/scenario.toml has changed since the run"
    assert "map.yaml" not in result.stderr


def test_a_run_of_one_step_has_one_step_in_all_texts(floor: str) -> None:
    explored = explore(floor, "--steps", "1", "--out", "run").stdout
    assert "Not finished after 1 step: " in explored
    assert murmur("replay", "run").stdout.startswith("Replay matches: 1 step, digest ")
    assert murmur("report", "run").exit_code == 0
    assert "Not finished after 1 step: " in Path("run/report.html").read_text()
    again = exploration.explore(load(Path("run/scenario.toml")), keep=False)
    assert " after 1 step, " in repr(again)


def test_a_report_is_written_where_out_says_and_nothing_else_changes(floor: str) -> None:
    for name, seed in (("run", "1"), ("other", "2")):
        explore(floor, "--steps", "4", "--seed", seed, "--out", name)
    before = {path: path.stat().st_mtime_ns for path in Path("run").rglob("*")}
    for words, page in ((["run"], "page.html"), (["run", "other"], "both.html")):
        result = murmur("report", *words, "--out", page)
        assert (result.exit_code, result.stdout[: len(page)]) == (0, page), result.stderr
        assert "<img" in Path(page).read_text()
    assert {path: path.stat().st_mtime_ns for path in Path("run").rglob("*")} == before
    assert murmur("report", "run", "--out", "missing/page.html").stderr.startswith(
        "murmur: missing/page.html: No such"
    )


def test_errors_say_that_there_is_no_capture(floor: str) -> None:
    Path("empty").mkdir()
    missing, empty = murmur("capture", "missing"), murmur("capture", "empty")
    assert (missing.exit_code, empty.exit_code) == (2, 2)
    assert (
        missing.stderr
        == "murmur: missing: No such file or directory; name the directory of a run, or a capture\n"
    )
    assert empty.stderr == "murmur: empty: not a run directory: radio.pcapng is missing\n"


@pytest.mark.parametrize(
    ("what", "why"),
    [
        ({"reason": "interrupted"}, "it was interrupted at step 4"),
        ({"reason": "broken off"}, "it was broken off at step 4"),
        ({"clock": "field", "lost": {"1": "its record is missing"}}, "it was in the field"),
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


class WithoutMaps:
    """A robot's end of the bus that loses the parts of its maps."""

    def __init__(self, inner: Bus) -> None:
        self._inner = inner
        self.receive, self.close = inner.receive, inner.close

    def put(self, key: str, payload: bytes) -> None:
        if names.parts(key)[0] != "control" or not isinstance(rights.read(key, payload), MapPart):
            self._inner.put(key, payload)


def test_a_run_is_replayed_although_the_maps_of_a_robot_did_not_arrive(floor: str) -> None:
    plan = plans.make(parse({"map": floor, "robots": 2, "bus": "memory", "steps": 8}))
    folder = run_directory.create(Path("run"), plan)
    records = MemoryRun(plan, wrap=lambda name, bus: WithoutMaps(bus) if name == "r1" else bus).complete()
    result = conclude(plan, Outcome(records, {}), folder, 1.0)
    assert result.exit_code == 3
    assert result.summary["lost"] == {"1": "it did not send its maps"}
    replayed = murmur("replay", "run")
    assert (replayed.exit_code, replayed.stdout[:14]) == (0, "Replay matches"), replayed.stderr
    summary = json.loads(Path("run/summary.json").read_text())
    Path("run/summary.json").write_text(json.dumps(summary | {"lost": {"0": "it did not send its maps"}}))
    assert murmur("replay", "run").exit_code == 1


FULL_DISK = """
import resource, sys
from deploy.after import export, report
from deploy.commands.app import app
resource.setrlimit(resource.RLIMIT_FSIZE, (9000, resource.RLIM_INFINITY))
app(sys.argv[1:])
"""


@pytest.mark.parametrize(
    "words",
    [
        "explore --map floor.yaml --bus memory --out two --json",
        pytest.param("report run", marks=pytest.mark.long),
        "export run --mcap",
    ],
)
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
    assert last.startswith(("murmur: two/", "murmur: run/"))
    assert "Traceback" not in done.stderr
    assert not [*Path("run").glob("pictures/*"), *Path("run").glob("rosbag"), *Path("run").glob(".*")]


def test_settings_that_another_version_wrote_are_named_as_such(floor: str) -> None:
    explore(floor, "--steps", "4", "--out", "run")
    scenario = Path("run/scenario.toml")
    scenario.write_text("death = 3\n" + scenario.read_text())
    for words in (["report"], ["movie"], ["export", "--mcap"], ["replay"]):
        result = murmur(*words, "run")
        assert result.exit_code == 2
        assert "death: unknown setting" in result.stderr
        assert (
            "run: the settings of a finished run cannot be read: another version of Murmur" in result.stderr
        )


def test_a_capture_says_how_many_bytes_it_cannot_read(floor: str) -> None:
    explore(floor, "--steps", "4", "--out", "run")
    assert "not readable" not in murmur("capture", "run").stdout
    capture = Path("run/radio.pcapng")
    with capture.open("rb") as file:
        first = next(frame.payload for frame in read(Reader(file)) if len(frame.payload) > 20)
    capture.write_bytes(capture.read_bytes().replace(first, b"\xff" * len(first)))
    last = murmur("capture", "run").stdout.splitlines()[-1]
    assert re.match(r"\d+ bytes of carried frames are not readable, and not in these totals", last)
