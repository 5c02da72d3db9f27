"""The recording of a run: all reports are in the file, on the timeline of steps."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from deploy.commands.app import app
from deploy.dashboard.process import RECORDING, ViewNode, ViewTask, free_name, watching
from deploy.dashboard.windows import Window, WindowError, binary, free_port
from deploy.record.map_quality import true_walls_of
from deploy.run.exploration import explore
from deploy.run.in_memory import MemoryRun
from deploy.scenario.plan import make
from deploy.scenario.scenario import parse
from netshaper import capture, pcapng
from protocol import keys as names
from protocol.bus import Message
from protocol.grid import FREE
from protocol.keys import Keys
from protocol.message_codec import pack
from protocol.messages import ErrorReport, Outlines, RadioReport, RobotStatus, Shutdown, Snapshot, WorldReport
from tests.deploy.small_run import SETTINGS, Listener, reports, small_plan, small_run
from worldsim.maps import to_world

rerun = pytest.importorskip("rerun", reason="Rerun is not installed: pip install 'murmur-robots[view]'")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recorded")
    with watching(ViewTask(small_plan(), folder)) as node:
        for sender, report in reports():
            node.take(sender, report)
    return folder


def column(recording: Path, entity: str, component: str) -> dict[int, Any]:
    """The values of a component by step."""
    import rerun.chunk  # the reader is not part of the main module

    values: dict[int, Any] = {}
    for chunk in rerun.chunk.RrdReader(recording).stream().filter(content=entity):
        batch = chunk.to_record_batch()
        names = [name for name in batch.schema.names if name.endswith(f":{component}")]
        if names and "step" in batch.schema.names:
            values |= dict(zip(batch["step"].to_pylist(), batch[names[0]].to_pylist(), strict=True))
    return {step: value for step, value in sorted(values.items()) if value is not None}


def test_people_are_recorded_every_step(tmp_path: Path) -> None:
    people: dict[str, Any] = {"people": {"number": 2}, "laser": {"preset": "rplidar-a1"}, "steps": 5}
    plan, listener = make(parse(SETTINGS | people)), Listener()
    MemoryRun(plan, view=ViewNode(listener.take)).complete()
    with watching(ViewTask(plan, tmp_path)) as node:
        for sender, report in listener.reports:
            node.take(sender, report)
    recorded = column(tmp_path / RECORDING, "/world/people", "positions")
    true = {
        report.step: np.frombuffer(report.people, "<i4").reshape(2, 2) / 1000
        for _, report in listener.reports
        if isinstance(report, WorldReport)
    }
    assert list(recorded) == [1, 2, 3, 4, 5]
    for step, places in recorded.items():
        left, bottom = to_world(plan.map, 0, 0)
        shown = np.array(places) - (left, -bottom)
        assert shown == pytest.approx(true[step], abs=0.001)


def test_the_explored_share_is_recorded_every_step(recorded: Path) -> None:
    seen = column(recorded / RECORDING, "/explored/team", "scalars")
    truth = {
        report.step: 100 * report.seen / report.reachable
        for _, report in reports()
        if isinstance(report, WorldReport)
    }
    assert {step: value[0] for step, value in seen.items()} == pytest.approx(truth)


def test_each_robots_share_is_that_of_its_planning_map(recorded: Path) -> None:
    shares = column(recorded / RECORDING, "/explored/maps", "scalars")
    plan = small_plan()
    reachable = plan.make_world().reachable
    grid = small_run().records.maps.planning(1, 30)
    assert grid is not None
    assert shares[30][1] == pytest.approx(100 * (grid[reachable] == FREE).mean())


def test_the_walls_on_each_planning_map_are_compared_with_the_true_ones(recorded: Path) -> None:
    f1 = column(recorded / RECORDING, "/walls/f1", "scalars")
    precision = column(recorded / RECORDING, "/walls/precision", "scalars")
    plan = small_plan()
    grid = small_run().records.maps.planning(1, 30)
    assert grid is not None
    score = true_walls_of(plan, plan.make_world().reachable).score(grid)
    assert score.f1 and score.precision
    assert f1[30][1] == pytest.approx(100 * score.f1)
    assert precision[30][1] == pytest.approx(100 * score.precision)


def test_traffic_by_type_adds_up_to_the_load(recorded: Path) -> None:
    load = column(recorded / RECORDING, "/traffic/load", "scalars")
    for _, report in reports():
        if isinstance(report, RadioReport):
            total, *groups = load[report.step]
            assert total == report.carried == np.nansum(groups)
    budget = column(recorded / RECORDING, "/traffic/budget", "scalars")
    assert set(budget) == set(range(1, 41))


def test_maps_outlines_targets_and_events_are_recorded(recorded: Path) -> None:
    file = recorded / RECORDING
    for robot in range(3):
        pictures = column(file, f"/robots/{robot}/map", "blob")
        assert len(pictures) >= 6
        assert column(file, f"/robots/{robot}/outlines/{robot}", "strips")
        assert column(file, f"/robots/{robot}/target", "positions")
        assert len(column(file, f"/paths/{robot}", "strips")) == 40
    assert any(vectors for vectors in column(file, "/world/links/busy", "vectors").values())
    assert any("heads for" in str(text) for text in column(file, "/events", "text").values())


DEFAULTS = {"map": "office", "robots": 3, "range": "30%", "steps": 25, "bus": "memory"}
LOSSY = DEFAULTS | {"radio": {"loss": 0.4}}


@pytest.mark.parametrize("settings", [DEFAULTS, LOSSY], ids=["perfect", "lossy"])
def test_broadcasts_are_drawn_from_their_sender_to_the_robots_that_received_them(
    settings: dict[str, Any], tmp_path: Path
) -> None:
    explore(parse(settings), out=tmp_path / "run", window=Window("file"))
    file = tmp_path / "run" / RECORDING
    places = column(file, "/world/robots", "positions")
    origins = column(file, "/world/links/busy", "origins")
    vectors = column(file, "/world/links/busy", "vectors")
    drawn = {
        step: sorted(
            _link(places[step], start, vector) for start, vector in zip(starts, vectors[step], strict=True)
        )
        for step, starts in origins.items()
    }
    received: dict[int, set[tuple[int, int]]] = {step: set() for step in places}
    with (tmp_path / "run" / "radio.pcapng").open("rb") as stream:
        for frame in capture.read(pcapng.Reader(stream)):
            received[frame.step] |= {(frame.sender, robot) for robot in frame.receivers}
    apart = [step for step in drawn if step > 8]  # before, robots stand too close for arrows
    assert {step: drawn[step] for step in apart} == {step: sorted(received[step]) for step in apart}
    assert sum(len(drawn[step]) for step in apart) > 20


def _link(places: Any, start: Any, vector: Any) -> tuple[int, int]:
    """The robots at the start and closest to the tip of an arrow; it starts at a robot of the same step."""
    at, tip = np.array(places), np.array(start) + vector
    (sender,) = np.flatnonzero(np.abs(at - start).max(axis=1) < 1e-6)
    away = [
        abs(float(vector[0] * (place - start)[1] - vector[1] * (place - start)[0]))
        + (1e9 if np.dot(place - tip, vector) < -1e-6 else 0.0)
        for place in at
    ]
    away[sender] = np.inf
    return int(sender), int(np.argmin(away))


def test_targets_are_those_that_robots_chose_in_the_same_step(recorded: Path) -> None:
    ways = column(recorded / RECORDING, "/world/targets/ways", "strips")
    plan = small_plan()
    chosen: dict[int, list[tuple[float, float]]] = {step: [] for step in range(1, 41)}
    for _, report in sorted(reports(), key=lambda each: each[0]):
        if isinstance(report, RobotStatus) and report.target_x >= 0:
            x, y = to_world(plan.map, report.target_x, report.target_y)
            chosen[report.step].append((x, -y))
    for step, strips in ways.items():
        ends = [strip[-1] for strip in strips]
        assert np.array(ends) == pytest.approx(np.array(chosen[step]), abs=1e-4), step


def test_a_lagging_radio_changes_nothing_that_is_drawn(recorded: Path, tmp_path: Path) -> None:
    """The radio's report of each step arrives after the world's report of the next one."""
    waiting: list[tuple[str, object]] = []
    with watching(ViewTask(small_plan(), tmp_path)) as node:
        for sender, report in reports():
            if isinstance(report, RadioReport):
                waiting.append((sender, report))
                continue
            node.take(sender, report)
            if isinstance(report, WorldReport | Shutdown):
                for late in waiting:
                    node.take(*late)
                waiting = []
    for path, component in (
        ("/world/links/busy", "vectors"), ("/world/links/quiet", "strips"), ("/world/robots", "positions"),
        ("/traffic/load", "scalars"), ("/world/targets/ways", "strips"),
    ):  # fmt: skip
        one, other = (column(folder / RECORDING, path, component) for folder in (tmp_path, recorded))
        assert str(one) == str(other), path


def test_a_recording_is_complete(recorded: Path) -> None:
    import subprocess

    done = subprocess.run(
        [binary(), "rrd", "verify", recorded / RECORDING], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert [path.name for path in sorted(recorded.iterdir())] == [RECORDING]


def test_a_second_recording_does_not_overwrite_the_first(tmp_path: Path) -> None:
    path = tmp_path / RECORDING
    assert free_name(path) == path
    path.touch()
    (tmp_path / "run-2.rrd").touch()
    assert free_name(path) == tmp_path / "run-3.rrd"


def test_a_viewer_changes_no_digest(tmp_path: Path) -> None:
    plain = explore(parse(SETTINGS), keep=False)
    shown = explore(parse(SETTINGS), out=tmp_path / "run", window=Window("file"), pace=1000.0)
    assert plain.summary["digest"] == shown.summary["digest"] == small_run().summary["digest"]
    assert (tmp_path / "run" / RECORDING).stat().st_size > 10000


def test_the_relay_sends_the_capture_to_no_viewer() -> None:
    kinds = {type(report) for _, report in reports()}
    assert {WorldReport, RobotStatus, RadioReport, Snapshot, Outlines, Shutdown} <= kinds
    assert all(report.frames == b"" for _, report in reports() if isinstance(report, RadioReport))


def test_a_missing_display_or_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert Window("auto").mode == "web"
    assert Window("file").port is None
    with pytest.raises(WindowError, match="no display"):
        Window("native")
    with pytest.raises(WindowError, match="must be one of auto, native, web, file"):
        Window("cinema")
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(WindowError, match=r"pip install 'murmur-robots\[view\]'"):
        Window("file")


def test_a_display_counts_if_its_server_answers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A terminal may keep the name of a display that has gone, for example after a new login."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-7")
    monkeypatch.delenv("DISPLAY", raising=False)
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "wayland-7"))
        assert Window("auto").mode == "web"
        server.listen()
        assert Window("auto").mode == "native"
    monkeypatch.delenv("WAYLAND_DISPLAY")
    free = next(number for number in range(70, 99) if not Path(f"/tmp/.X11-unix/X{number}").exists())
    with socket.socket(socket.AF_UNIX) as server:
        monkeypatch.setenv("DISPLAY", f":{free}.0")
        assert Window("auto").mode == "web"
        server.bind(f"\0/tmp/.X11-unix/X{free}")
        server.listen()
        assert Window("auto").mode == "native"
    with socket.socket() as server:
        port = next(port for port in range(6070, 6099) if free_port(port=port))
        server.bind(("127.0.0.1", port))
        monkeypatch.setenv("DISPLAY", f"127.0.0.1:{port - 6000}")
        assert Window("auto").mode == "web"
        server.listen()
        assert Window("auto").mode == "native"


@pytest.mark.parametrize("name", ["screen", ":", "127.0.0.1:x", "127.0.0.1:99999", "no-such-host.invalid:0"])
def test_a_malformed_display_is_none(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setenv("DISPLAY", name)
    assert Window("auto").mode == "web"


def test_a_finished_run_cannot_be_recorded(tmp_path: Path) -> None:
    (tmp_path / RECORDING).touch()
    done = CliRunner().invoke(app, ["watch", str(tmp_path), "--view-as", "file"])
    assert (done.exit_code, done.stdout) == (2, "")
    assert f"view-as = 'file': {tmp_path / RECORDING} is complete; use 'native' or 'web'" in done.stderr


def test_a_run_with_a_viewer_needs_a_directory() -> None:
    with pytest.raises(ValueError, match="needs a run directory"):
        explore(parse(SETTINGS), keep=False, window=Window("file"))
    with pytest.raises(ValueError, match=r"pace = 0.1: must be 0.5 steps per second or more"):
        explore(parse(SETTINGS), keep=False, pace=0.1)


def test_maps_of_another_size_and_floods_of_maps_are_not_drawn(tmp_path: Path) -> None:
    plan = small_plan()
    width, height = plan.map.width, plan.map.height
    keys = Keys("run")
    with watching(ViewTask(plan, tmp_path)) as node:
        shown: list[object] = []
        take = node.take
        node.take = lambda sender, report: (take(sender, report), shown.append(report))
        for size in ((1, 1), (height + 1, width), (width, height)):
            grid = bytes(-(-size[0] // 4) * size[1])
            for _ in range(5):
                snapshot = Snapshot(1, *size, grid)
                node.handle(Message(keys.control(names.VIEW, "r1"), pack(snapshot)))
        for number in range(300):
            report = ErrorReport("r1", f"error {number}")
            node.handle(Message(keys.control(names.VIEW, "r1"), pack(report)))
    events = column(tmp_path / RECORDING, "/events", "text")
    assert [type(report) for report in shown].count(Snapshot) == 5
    assert sum(isinstance(report, ErrorReport) and "cells" in report.reason for report in shown) == 10
    assert len(events) == 1, "all of step 0"
