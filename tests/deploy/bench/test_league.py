"""The league table: all strategies on the same starts, compared with the same plan."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from deploy.bench import league
from deploy.commands.app import app

SMALL = [
    "--map",
    "leader-rooms",
    "--robots",
    "2",
    "--seeds",
    "1",
    "--strategy",
    "meier",
    "--strategy",
    "burgard",
]


def test_the_table_has_a_row_per_strategy_and_the_offline_plan(tmp_path: Path) -> None:
    picture = tmp_path / "league.png"
    output = CliRunner().invoke(app, ["bench", "strategies", *SMALL, "--json", "--picture", str(picture)])
    assert output.exit_code == 0, output.output
    rows = {row["strategy"]: row for row in json.loads(output.stdout)}
    assert set(rows) == {league.OFFLINE, "meier", "burgard"}
    assert rows[league.OFFLINE]["multiple"] == 1.0
    assert rows[league.OFFLINE]["steps"] <= min(rows[n]["steps"] for n in ("meier", "burgard"))
    for name in ("meier", "burgard"):
        row = rows[name]
        assert row["t90"] <= row["t99"] <= row["steps"]
        assert row["min_path"] <= 1 <= row["max_path"]
        assert row["replan_ms"] > 0
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_the_table_is_sorted_by_multiple_whatever_the_order_of_runs() -> None:
    run = {
        "map": "a",
        "robots": 2,
        "seed": 0,
        "finished": True,
        "t90": 1,
        "t99": 2,
        "coverage": 1.0,
        "driven": [1.0, 3.0],
        "replan_ms": 1.0,
    }
    runs: list[league.Run] = [
        {"strategy": "slow", **run, "steps": 30},
        {"strategy": league.OFFLINE, "map": "a", "robots": 2, "seed": 0, "steps": 10},
        {"strategy": "quick", **run, "steps": 15},
        {"strategy": "stalls", **run, "steps": 5, "finished": False},
    ]
    table = league.table(runs)
    assert table["strategy"].to_list() == [league.OFFLINE, "quick", "slow", "stalls"]
    assert table["multiple"].to_list()[1:] == [1.5, 3.0, None]
    assert table.equals(league.table(runs[::-1]))
    assert table["max_path"].to_list()[1:] == [1.5, 1.5, 1.5]
    assert league.lines(table)[2][:7] == ["quick", "1", "1.00", "15", "1", "2", "1.50"]


@pytest.mark.parametrize(
    ("flags", "output"), [(["--strategy", "meyer"], "meyer"), (["--map", "offise"], "offise")]
)
def test_errors_name_unknown_strategies_and_maps(flags: list[str], output: str) -> None:
    result = CliRunner().invoke(app, ["bench", "strategies", "--seeds", "1", *flags])
    assert result.exit_code == 2
    assert output in result.stderr
