"""The league table: all on the same starts, against the same plan."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from deploy.bench import league
from deploy.commands.main import app

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


def test_the_table_has_a_row_a_strategy_and_two_of_what_is_possible(tmp_path: Path) -> None:
    picture = tmp_path / "league.png"
    said = CliRunner().invoke(app, ["bench", "strategies", *SMALL, "--json", "--picture", str(picture)])
    assert said.exit_code == 0, said.output
    rows = {row["strategy"]: row for row in json.loads(said.stdout)}
    assert set(rows) == {league.KNOWN, league.BOUND, "meier", "burgard"}
    assert rows[league.KNOWN]["multiple"] == 1.0
    assert (
        rows[league.BOUND]["steps"]
        <= rows[league.KNOWN]["steps"]
        <= min(rows[n]["steps"] for n in ("meier", "burgard"))
    )
    for name in ("meier", "burgard"):
        row = rows[name]
        assert row["t90"] <= row["t99"] <= row["steps"]
        assert row["least"] <= 1 <= row["most"]
        assert row["replan_ms"] > 0
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_the_order_of_the_table_is_that_of_multiples_whoever_was_first_to_end() -> None:
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
        {"strategy": league.KNOWN, "map": "a", "robots": 2, "seed": 0, "steps": 10},
        {"strategy": "quick", **run, "steps": 15},
        {"strategy": "stalls", **run, "steps": 5, "finished": False},
    ]
    table = league.table(runs)
    assert table["strategy"].to_list() == [league.KNOWN, "quick", "slow", "stalls"]
    assert table["multiple"].to_list()[1:] == [1.5, 3.0, None]
    assert table.equals(league.table(runs[::-1]))
    assert table["most"].to_list()[1:] == [1.5, 1.5, 1.5]
    assert league.lines(table)[2][:7] == ["quick", "1", "1.00", "15", "1", "2", "1.50"]


@pytest.mark.parametrize(
    ("flags", "said"), [(["--strategy", "meyer"], "meyer"), (["--map", "offise"], "offise")]
)
def test_who_or_what_is_unknown_is_named(flags: list[str], said: str) -> None:
    result = CliRunner().invoke(app, ["bench", "strategies", "--seeds", "1", *flags])
    assert result.exit_code == 2
    assert said in result.stderr
