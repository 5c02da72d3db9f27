"""What the maps of recorded logs cost, and how well teammates hold them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from deploy.run.exploration import explore

LOGS = Path(__file__).parents[2] / "../shared/logs"


def play(name: str, *, robots: int, listeners: int = 0, **settings: Any) -> dict[str, Any]:
    """Replay a log, and return the summary."""
    log = LOGS / name
    if not log.exists():
        pytest.skip(f"no {log}: recorded logs are not part of the repository")
    recording = {"files": [str(log)], "listeners": listeners, **settings.pop("recording", {})}
    team = {"robots": robots + listeners, "bus": "memory", "bandwidth": "unlimited", "keep": False}
    return explore(recording=recording, **(team | settings)).summary


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "every", "robots", "most"),
    [
        ("intel.log.gz", 1, 1, 12),
        ("intel.log.gz", 1, 8, 14),
        ("freiburg-079.log.gz", 5, 8, 14),
        ("aces.log.gz", 1, 8, 28),
    ],
)
def test_teammates_hold_the_walls_of_a_log_at_few_bytes_per_scan(
    name: str, every: int, robots: int, most: float
) -> None:
    summary = play(name, robots=robots, listeners=int(robots == 1), recording={"every": every})
    assert summary["finished"]
    assert summary["worst_walls_within_tolerance"] >= 0.99
    assert summary["bytes_per_scan"] <= most


@pytest.mark.long
@pytest.mark.parametrize("robots", [1, 8])
def test_a_team_keeps_up_with_the_recorded_pace_at_50_bytes_per_step(robots: int) -> None:
    listeners = int(robots == 1)
    pace = {"pace": "recorded"}
    summary = play("intel.log.gz", robots=robots, listeners=listeners, bandwidth=50, recording=pace)
    assert summary["finished"]
    assert summary["steps_after_scans"] <= 60
    assert summary["worst_walls_within_tolerance"] >= 0.99


def test_a_listener_holds_the_walls_of_a_short_log() -> None:
    summary = play("intel.log.gz", robots=1, listeners=1, recording={"every": 20})
    assert (summary["scans"], summary["finished"]) == (46, True)
    assert summary["worst_walls_within_tolerance"] >= 0.99
    assert 0 < summary["bytes_per_scan"] < 150


def test_no_wall_is_forgotten_on_a_scarce_medium() -> None:
    summary = play("intel.log.gz", robots=4, recording={"every": 20}, bandwidth=30)
    assert summary["finished"]
    assert summary["worst_walls_within_tolerance"] >= 0.99
