"""`murmur watch`: the file that announces a running run, and the file that a killed run leaves."""

from __future__ import annotations

import json
import os
import socket
from pathlib import Path

import pytest

from deploy.dashboard.watch import LIVE, announced, read_live, recording_of
from deploy.scenario.errors import ScenarioError
from protocol.zenoh_bus import Credential


def credential(port: int) -> Credential:
    return Credential("run", "view", f"tcp/127.0.0.1:{port}", "secret")


def test_a_running_run_announces_its_viewer_credential_to_its_owner_only(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as hub:
        mine = credential(hub.getsockname()[1])
        with announced(tmp_path, mine, 4711):
            assert read_live(tmp_path) == (mine, 4711)
            assert (tmp_path / LIVE).stat().st_mode & 0o777 == 0o600
    assert read_live(tmp_path) is None
    assert not (tmp_path / LIVE).exists()
    with announced(None, mine, None):
        assert not list(tmp_path.iterdir())


def test_the_live_file_of_a_killed_run_is_ignored(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as hub:
        port = hub.getsockname()[1]
    (tmp_path / LIVE).write_text(json.dumps({**vars(credential(port)), "port": None}))
    assert read_live(tmp_path) is None


def test_a_damaged_file_is_named(tmp_path: Path) -> None:
    (tmp_path / LIVE).write_text("{")
    with pytest.raises(ValueError, match=r"live\.json: not JSON"):
        read_live(tmp_path)


def test_the_newest_recording_is_opened(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"no recording \(run.rrd\)"):
        recording_of(tmp_path)
    (tmp_path / "run.rrd").touch()
    assert recording_of(tmp_path) == tmp_path / "run.rrd"
    (tmp_path / "run-2.rrd").touch()
    os.utime(tmp_path / "run.rrd", (1, 1))
    assert recording_of(tmp_path) == tmp_path / "run-2.rrd"
