"""Restarts after unexpected ends: a robot where it died, the whole run if relay or world die."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil
import pytest

from deploy.record.records import Records
from deploy.run import launch
from deploy.run.control import why_unrepeatable
from deploy.run.exit_codes import BROKEN_OFF, EXPLORED
from deploy.run.exploration import explore
from deploy.scenario.errors import ScenarioError
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import parse


def scenario(**settings: Any) -> Any:
    return parse(
        {"map": "leader-rooms", "robots": 2, "sensor_range": 2.5, "dissemination": "gossip"} | settings
    )


def killing(name: str, step: int, number: signal.Signals = signal.SIGKILL) -> Callable[[Plan, Records], None]:
    """Send a participant a signal as soon as a step has been reached; once."""
    sent: list[int] = []

    def watch(_: Plan, records: Records) -> None:
        for child in psutil.Process(os.getpid()).children(recursive=True) if records.step >= step else ():
            if not sent and child.name().startswith(f"murmur {name}"):
                sent.append(child.pid)
                child.send_signal(number)

    return watch


@pytest.mark.parametrize(
    ("name", "number"),
    [
        ("world", signal.SIGKILL),
        pytest.param("relay", signal.SIGSTOP, marks=pytest.mark.long),
        pytest.param("world", signal.SIGSTOP, marks=pytest.mark.long),
        pytest.param("relay", signal.SIGKILL, marks=pytest.mark.long),
    ],
)
def test_run_whose_world_or_relay_dies_or_hangs_reaches_the_digest_of_an_undisturbed_run(
    tmp_path: Path, name: str, number: signal.Signals
) -> None:
    plain = explore(scenario(bus="memory"), keep=False)
    notes: list[str] = []
    result = explore(
        scenario(reply_timeout_s=2.0),
        out=tmp_path / "run",
        watch=killing(name, 10, number),
        notify=notes.append,
        pace=20,
        restart=True,
    )
    assert len(notes) == 1, result.summary
    assert name in notes[0]
    assert (result.exit_code, result.deaths) == (EXPLORED, {})
    assert result.summary["digest"] == plain.summary["digest"]
    assert why_unrepeatable(result.summary) == ""


def test_killed_robot_rejoins_and_the_run_ends_explored(tmp_path: Path) -> None:
    result = explore(scenario(), out=tmp_path / "run", watch=killing("r1", 5), pace=20, restart=True)
    assert (result.exit_code, result.deaths, result.summary["lost"]) == (EXPLORED, {}, {})
    ((step, robot),) = result.summary["returned"]
    assert robot == 1
    assert step >= 5
    assert "robot 1 was lost at step" in why_unrepeatable(result.summary)
    assert sorted(result.records.own) == [0, 1]
    assert {report.step for report in result.records.statuses[1]} >= {1, result.summary["steps"]}


def test_run_continues_if_a_robot_dies_while_the_run_is_repeated(tmp_path: Path) -> None:
    first, second = killing("relay", 10), killing("r1", 0)
    notes: list[str] = []

    def watch(plan: Plan, records: Records) -> None:
        (second if notes else first)(plan, records)

    result = explore(
        scenario(), out=tmp_path / "run", watch=watch, notify=notes.append, pace=20, restart=True
    )
    assert (result.exit_code, result.deaths, result.summary["lost"]) == (EXPLORED, {}, {})


def test_run_that_cannot_be_repeated_keeps_what_it_has_recorded(tmp_path: Path) -> None:
    watch = killing("relay", 10)
    notes: list[str] = []

    def break_again(note: str) -> None:
        notes.append(note)
        monkeypatch.setattr(launch, "join", refuse)

    def refuse(_: object) -> None:
        raise ConnectionError("no hub answers")

    with pytest.MonkeyPatch.context() as monkeypatch:
        result = explore(
            scenario(),
            out=tmp_path / "run",
            watch=watch,
            notify=break_again,
            pace=20,
            restart=True,
            check=False,
        )
    assert result.exit_code == BROKEN_OFF
    assert result.summary["steps"] >= 10
    assert len(notes) == 3
    assert (tmp_path / "run" / "radio.pcapng").stat().st_size > 1000


def test_run_waits_for_its_only_robot(tmp_path: Path) -> None:
    result = explore(scenario(robots=1), out=tmp_path / "run", watch=killing("r0", 5), pace=20, restart=True)
    assert result.exit_code == EXPLORED
    assert [robot for _, robot in result.summary["returned"]] == [0]


def test_run_that_cannot_be_restarted_is_rejected_before_anything_starts() -> None:
    with pytest.raises(ScenarioError, match="has no processes that could die"):
        explore(scenario(bus="memory"), keep=False, restart=True)
    with pytest.raises(ScenarioError, match="40 robots can start 1 times each, not 2 times"):
        explore(scenario(robots=40, dissemination="backoff"), keep=False, restart=True)
