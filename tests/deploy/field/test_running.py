"""Robots that run on this host, and the request to stop."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import pytest

from deploy.field import running as registered
from deploy.field.running import ask_to_stop, has_ended, is_running, robots, running
from deploy.scenario.errors import ScenarioError
from tests.deploy.commands.office_floor import murmur


@pytest.fixture(autouse=True)
def own_registry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Name the robots of this test apart from those of the host."""
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))


def test_a_running_robot_is_asked_by_a_file(tmp_path: Path) -> None:
    folder = tmp_path / "record"
    with running(folder) as stop:
        assert not stop.exists()
        assert is_running(folder)
        assert robots() == [folder]
        ask_to_stop(folder)
        assert stop.exists()
        assert not has_ended(folder, 0.0)
    assert not stop.exists()
    assert has_ended(folder, 0.0)
    assert robots() == []


def test_two_robots_cannot_record_in_one_directory(tmp_path: Path) -> None:
    with (
        running(tmp_path),
        pytest.raises(ScenarioError, match="a robot runs there already; murmur stop"),
        running(tmp_path),
    ):
        pass


def test_an_old_request_does_not_stop_a_new_robot(tmp_path: Path) -> None:
    (tmp_path / "stop").touch()
    with running(tmp_path) as stop:
        assert not stop.exists()


def test_a_killed_robot_is_forgotten(tmp_path: Path) -> None:
    with running(tmp_path / "record"):
        (entry,) = (tmp_path / "tmp").glob("murmur-robots-*/*")
        text = entry.read_text()
    entry.write_text(text)
    assert robots() == []
    assert not entry.exists()


def test_robots_that_begin_and_end_meanwhile_do_not_hinder_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with running(tmp_path / "record"):
        (entry,) = (tmp_path / "tmp").glob("murmur-robots-*/*")
        ended, begun = entry.with_name("ended"), entry.with_name("begun")
        ended.symlink_to("gone")
        begun.touch()
        assert robots() == [tmp_path / "record"]
        assert begun.exists()


def test_all_other_robots_are_stopped_if_one_has_just_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(registered, "robots", lambda: [tmp_path / "ended", tmp_path / "record"])
    monkeypatch.setattr(registered, "has_ended", lambda *_: True)
    with running(tmp_path / "record") as stop:
        assert murmur("stop", "--all").exit_code == 0
        assert stop.exists()
        assert murmur("stop", str(tmp_path / "ended"), str(tmp_path / "record")).exit_code == 2


def test_a_file_in_place_of_the_names_of_all_robots_is_reported(tmp_path: Path) -> None:
    (tmp_path / "tmp" / f"murmur-robots-{os.getuid()}").touch()
    with pytest.raises(ScenarioError, match="is not a directory of this user: remove it"):
        robots()


def test_without_a_robot_there_is_nothing_to_stop(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="no robot runs there; murmur stop --all"):
        ask_to_stop(tmp_path)
    assert murmur("stop", str(tmp_path)).exit_code == 2
    assert murmur("stop").exit_code == 2
    every = murmur("stop", "--all")
    assert (every.exit_code, every.stdout) == (0, "no robot of this user runs on this host\n")


@pytest.mark.parametrize(("name", "reason"), [("file", "File exists"), ("file/record", "Not a directory")])
def test_a_record_directory_that_cannot_be_created_is_named(tmp_path: Path, name: str, reason: str) -> None:
    (tmp_path / "file").touch()
    with (
        pytest.raises(ScenarioError, match=f"record.folder = '.*{name}': {reason}"),
        running(tmp_path / name),
    ):
        pass
