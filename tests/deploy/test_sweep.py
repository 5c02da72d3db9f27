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


def test_variants_may_be_chosen(tmp_path: Path) -> None:
    experiment = sweep.read(write(tmp_path, EXPERIMENT))
    assert {case.place["variant"] for case in sweep.cases(sweep.choose(experiment, ["scans"]))} == {"scans"}
    assert sweep.choose(experiment, []) == experiment
    with pytest.raises(ScenarioError, match="no variant is called 'scan'; there are: polygons, scans"):
        sweep.choose(experiment, ["scan"])
    text = EXPERIMENT.replace('"bytes.total"', '"bytes.total relative to scans"')
    with pytest.raises(ScenarioError, match="choose 'scans' as well"):
        sweep.choose(sweep.read(write(tmp_path, text)), ["polygons"])


def test_figures_are_names_sums_and_quotients() -> None:
    summary = {"steps": 4, "t99": None, "bytes": {"ins": 6, "conn": 2, "total": 16}}
    assert sweep.figure(summary, "steps") == 4
    assert sweep.figure(summary, "bytes.ins + bytes.del / bytes.total") == 6 / 16
    assert sweep.figure(summary, "bytes.conn / bytes.rm") is None
    for absent in ("t99", "staps", "bytes.ims", "packets.total", "t99 / steps"):
        assert sweep.figure(summary, absent) is None


def test_a_figure_may_be_told_in_relation_to_another_variant_on_the_same_run(tmp_path: Path) -> None:
    text = EXPERIMENT.replace('"bytes.total"', '"bytes.total relative to scans"')
    experiment = sweep.read(write(tmp_path, text.replace('columns = ["variant"]', "columns = []")))
    places = [
        {"robots": 2, "seed": seed, "variant": name} for seed in (0, 1) for name in ("polygons", "scans")
    ]
    runs = [
        {"place": place, "steps": 5, "bytes": {"total": total}}
        for place, total in zip(places, (10, 40, 30, 40), strict=True)
    ]
    assert sweep.tabulate(experiment, runs)[0] == ["robots", "steps", "bytes.total relative to scans"]
    assert sweep.tabulate(experiment, runs)[1] == ["2", "5.000", "0.750"]
    by_variant = sweep.read(write(tmp_path, text))
    assert sweep.tabulate(by_variant, runs)[1] == ["2", "5.000 0.500", "5.000 1.000"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("name = 'nothing'\n", "nothing to run"),
        ("base = 3\n", "must be a table, [base]"),
        (
            "[grid]\nrobots = [3]\n[table]\nvalues = ['steps relative to scans']\n",
            "no variant is called scans",
        ),
        ("[grid]\nrobots = [3]\n[table]\nvalues = ['steps / seed / robots']\n", "at most one"),
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
