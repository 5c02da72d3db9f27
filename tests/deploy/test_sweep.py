"""Sweeps: grids, variants, overrides, tables, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from deploy import sweep
from deploy.scenario import ScenarioError

EXPERIMENT = """
name = "small"
[base]
map = "em"
steps = 6
[grid]
robots = [1, 2]
seed = [0, 1]
[[variant]]
name = "polygons"
[[variant]]
name = "scans"
exchange = "laser"
[table]
rows = ["robots"]
columns = ["variant"]
values = ["steps", "bytes.total"]
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "small.toml"
    path.write_text(text)
    return path


def test_every_combination_of_grid_and_variants_is_run_once(tmp_path: Path) -> None:
    todo = sweep.cases(sweep.read(write(tmp_path, EXPERIMENT)))
    places = {(c.place["robots"], c.place["seed"], c.place["variant"]) for c in todo}
    assert len(todo) == len(places) == 8
    assert all(c.scenario.bus == "memory" and c.scenario.map == "em" for c in todo)
    assert {c.scenario.exchange for c in todo if c.place["variant"] == "scans"} == {"laser"}


def test_the_table_holds_means_by_row_and_column_and_over_all(tmp_path: Path) -> None:
    experiment = sweep.read(write(tmp_path, EXPERIMENT))
    todo = sweep.cases(experiment, {"seed": [3]})
    assert len(todo) == 4
    summaries = sweep.run(todo, jobs=1)
    head, *rows = sweep.tabulate(experiment, summaries)
    assert head == ["robots", "polygons", "scans"]
    assert [row[0] for row in rows] == ["1", "2", "all"]
    alone = summaries[0]["bytes"]["total"]
    assert rows[0][1] == f"{summaries[0]['steps']:.3f} {alone:.3f}"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[grid]\nrobots = 3\n", "grid.robots must be a list"),
        ("[gird]\nrobots = [3]\n", "gird is no table of an experiment"),
        ("[grid]\nrobots = [3]\n[table]\nrows = ['seed']\n", "'seed', which is not in the grid"),
        ("[[variant]]\nspeed = 1.0\n", "needs a name"),
        ("name = ", "not TOML"),
    ],
)
def test_an_experiment_that_makes_no_sense_is_refused_by_name(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ScenarioError, match=r"small\.toml") as caught:
        sweep.read(write(tmp_path, text))
    assert said in str(caught.value)


def test_a_wrong_setting_in_a_grid_names_its_place(tmp_path: Path) -> None:
    text = EXPERIMENT.replace("robots = [1, 2]", "robots = [1, 0]")
    with pytest.raises(ScenarioError, match=r"robots = 0, seed = 0, variant = polygons"):
        sweep.cases(sweep.read(write(tmp_path, text)))
