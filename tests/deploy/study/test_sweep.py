"""Sweeps: grids, variants, overrides, what is kept, and what is refused before the first run."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from deploy.commands.main import app
from deploy.scenario.scenario import ScenarioError, parse
from deploy.study import sweep
from worldsim import generators, maps

MURMUR = [sys.executable, "-m", "deploy.commands.main"]

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
    assert len({c.key for c in todo}) == 8
    assert all(c.scenario.bus == "memory" and c.scenario.map == "em" for c in todo)
    assert {c.scenario.exchange for c in todo if c.place["variant"] == "scans"} == {"laser"}


def test_finished_runs_are_kept_and_not_made_again(tmp_path: Path) -> None:
    keep = tmp_path / "kept.jsonl"
    todo = sweep.cases(sweep.override(sweep.read(write(tmp_path, EXPERIMENT)), {"robots": 1}))
    first = list(sweep.run(todo[:2], 1, keep))
    before = keep.read_text()
    again = list(sweep.run(todo[:2], 1, keep))
    assert again == first and keep.read_text() == before
    outcomes = list(sweep.run(todo, 1, keep))
    found = sweep.summaries(todo, outcomes)
    assert outcomes[:2] == first and len(keep.read_text().splitlines()) == len(todo)
    assert [each["place"] for each in found] == [case.place for case in todo]
    assert [each["seed"] for each in found] == [case.scenario.seed for case in todo]


def test_equal_runs_are_made_once(tmp_path: Path) -> None:
    text = EXPERIMENT.replace('exchange = "laser"', 'exchange = "polygon"')
    todo = sweep.cases(sweep.override(sweep.read(write(tmp_path, text)), {"robots": 1, "seed": 0}))
    outcomes = list(sweep.run(todo, 1))
    assert len(todo) == 2 and len(outcomes) == 1
    assert [each["place"]["variant"] for each in sweep.summaries(todo, outcomes)] == ["polygons", "scans"]


def test_a_run_is_another_with_any_other_setting_map_version_or_code(monkeypatch: pytest.MonkeyPatch) -> None:
    settings, world = {"map": "em", "bus": "memory"}, generators.make("em", seed=0)
    same = sweep.identity(parse(settings), world)
    assert same == sweep.identity(parse(settings | {"seed": 0}), generators.make("em", seed=0))
    others = [
        sweep.identity(parse(settings | {"polygon": {"lazy": False}}), world),
        sweep.identity(parse(settings), generators.make("jh-like", seed=0)),
    ]
    with monkeypatch.context() as patch:
        patch.setattr(sweep, "versions", lambda: {"python": "2"})
        others.append(sweep.identity(parse(settings), world))
    with monkeypatch.context() as patch:
        patch.setattr(sweep, "_code", lambda: "other")
        others.append(sweep.identity(parse(settings), world))
    assert len({same, *others}) == 5


def test_variants_may_be_chosen(tmp_path: Path) -> None:
    experiment = sweep.read(write(tmp_path, EXPERIMENT))
    assert {case.place["variant"] for case in sweep.cases(sweep.choose(experiment, ["scans"]))} == {"scans"}
    assert sweep.choose(experiment, []) == experiment
    with pytest.raises(ScenarioError, match="no variant is called 'scan'; there are: polygons, scans"):
        sweep.choose(experiment, ["scan"])
    text = EXPERIMENT.replace('"bytes.total"', '"bytes.total relative to scans"')
    with pytest.raises(ScenarioError, match="choose 'scans' as well"):
        sweep.choose(sweep.read(write(tmp_path, text)), ["polygons"])


def test_single_values_replace_lists_of_the_grid_as_lists_of_one(tmp_path: Path) -> None:
    experiment = sweep.read(write(tmp_path, 'grid.map = ["em", "office"]\ngrid.seed = [0, 1]\n'))
    other = sweep.override(experiment, {"map": "jh-like", "seed": 3, "robots": 2})
    assert [(c.scenario.map, c.scenario.seed, c.scenario.robots) for c in sweep.cases(other)] == [
        ("jh-like", 3, 2)
    ]


def test_maps_are_looked_for_beside_the_experiment_and_those_of_flags_where_one_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, here = tmp_path / "there", tmp_path / "here"
    for place, name in ((folder, "a"), (folder, "b"), (here, "c")):
        place.mkdir(exist_ok=True)
        maps.save(generators.make("em", seed=0), place / f"{name}.yaml")
    monkeypatch.chdir(here)
    experiment = sweep.read(write(folder, 'grid.map = ["a.yaml", "b.yaml", "em"]\n'))
    assert [c.scenario.map for c in sweep.cases(experiment)] == [
        str(folder / "a.yaml"), str(folder / "b.yaml"), "em"
    ]  # fmt: skip
    assert [c.scenario.map for c in sweep.cases(sweep.override(experiment, {"map": "c.yaml"}))] == ["c.yaml"]
    for text in ('base.map = "a.yaml"\n', '[[variant]]\nname = "it"\nmap = "a.yaml"\n'):
        (case,) = sweep.cases(sweep.read(write(folder, text)))
        assert case.scenario.map == str(folder / "a.yaml")


@pytest.mark.parametrize("path", sorted(sweep.SHIPPED.glob("*.toml")), ids=lambda path: path.stem)
def test_shipped_experiments_are_found_by_name_and_make_sense(path: Path) -> None:
    experiment = sweep.read(Path(path.name))
    assert experiment == sweep.read(path)
    assert sweep.cases(sweep.override(experiment, {"seed": 0, "map": "em"}))


def test_an_unknown_experiment_is_answered_with_those_there_are() -> None:
    with pytest.raises(
        ScenarioError, match=r"experiment none\.toml: no such file; shipped ones are kilobyte"
    ):
        sweep.read(Path("none.toml"))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("name = 'nothing'\n", "nothing to run"),
        ("base = 3\n", "must be a table, [base]"),
        (
            "[grid]\nrobots = [3]\n[table]\nvalues = ['steps relative to scans']\n",
            "no variant is called 'scans'; there are: plain",
        ),
        ("[grid]\nrobots = [3]\n[table]\nvalues = ['steps / seed / robots']\n", "at most one"),
        ("[grid]\nrobots = 3\n", "grid.robots = 3: must be a list of values, as [3, 5]"),
        ("[gird]\nrobots = [3]\n", "gird is no table of an experiment"),
        ("[grid]\nrobots = [3]\n[table]\nrows = ['seed']\n", "'seed', which is not in the grid"),
        ("[[variant]]\nspeed = 1.0\n", "needs a name"),
        ("name = ", "not TOML"),
        ("[grid]\nseed = []\n", "grid.seed = []: must be a list of values"),
        ("[grid]\nseed = [0, 1, 0]\n", "says 0 twice"),
        ("variant = []\n", "variant = []: must be tables, [[variant]]"),
        ("variant = 3\n", "variant = 3: must be tables, [[variant]]"),
        ("variant = [{ name = 'a' }, { name = 'a' }]\n", "two variants are called 'a'"),
        (
            "variant = [{ name = 'a', robots = 1 }]\n[grid]\nrobots = [2, 3]\n",
            "variant 'a' sets robots, which the grid sets",
        ),
        ("[base]\n[table]\nrows = 3\n", "table.rows = 3: must be a list of names"),
        (
            "[grid]\nseed = [1]\n[table]\nrows = [['seed']]\n",
            "table.rows = [['seed']]: must be a list of names",
        ),
        ("[base]\n[table]\nvalues = [3]\n", "table.values = [3]: must be a list of names"),
        (
            "[base]\n[table]\nvalues = 'steps'\n",
            "table.values = 'steps': must be a list of names, as ['steps'",
        ),
        ("[base]\n[table]\nvalues = []\n", "table.values = []: must name a figure"),
        ("[base]\n[table]\nvalues = ['stepz']\n", "'stepz' is no figure; there are: steps, coverage"),
        (
            "[base]\n[table]\nvalue = ['steps']\n",
            "table.value is no part of a table; there are: rows, columns, values",
        ),
    ],
)
def test_an_experiment_that_makes_no_sense_is_refused_by_name(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ScenarioError, match=r"small\.toml") as caught:
        sweep.read(write(tmp_path, text))
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"robots": [1, 0]}, "robots = 0, seed = 0, variant = polygons): robots = 0: "),
        ({"seed": None}, "seed = None: Input should be a valid integer"),
        ({"seed": []}, "--set seed = []: must be a list of values"),
        ({"variant": 3}, "--variant NAME chooses"),
        ({"robtos": 3}, "robtos is no setting"),
        ({"map": "nope"}, "variant = polygons): no environment is called 'nope'"),
        ({"map": "nope.yaml"}, "nope.yaml: cannot be read"),
        ({"start": [0, 0]}, "start on map em"),
        ({"bus": "zenoh"}, "bus = 'zenoh': sweeps run on the memory bus; leave it out"),
    ],
)
def test_a_case_that_cannot_be_run_is_refused_by_its_place(
    tmp_path: Path, settings: dict[str, Any], said: str
) -> None:
    experiment = sweep.read(write(tmp_path, EXPERIMENT))
    with pytest.raises(ScenarioError) as caught:
        sweep.cases(sweep.override(experiment, settings))
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_a_setting_that_every_variant_has_its_own_of_is_refused(tmp_path: Path) -> None:
    experiment = sweep.read(write(tmp_path, EXPERIMENT))
    sweep.override(experiment, {"exchange": "laser"})
    with pytest.raises(ScenarioError, match="--set exchange: without effect"):
        sweep.override(sweep.choose(experiment, ["scans"]), {"exchange": "polygon"})


def command(*words: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, ["sweep", *map(str, words)])
    return result.exit_code, result.stdout, result.stderr


def test_the_command_prints_the_table_and_keeps_a_summary_a_line(tmp_path: Path) -> None:
    path, out = write(tmp_path, EXPERIMENT), tmp_path / "all.jsonl"
    code, table, _ = command(path, "--jobs", 1, "--set", "robots=1", "--set", "seed=0", "--out", out)
    assert code == 0 and "steps bytes.total, means of 2 runs" in table
    lines = [json.loads(line) for line in out.read_text().splitlines()]
    assert {line["place"]["variant"] for line in lines} == {"polygons", "scans"}
    assert all(line["summary"]["steps"] == 6 for line in lines)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--out", "/nonexist/a.jsonl"], "out = /nonexist/a.jsonl: No such file or directory"),
        (["--set", "map=nope"], "no environment is called 'nope'"),
        (
            ["--set", "seed=0", "--set", "seed=1"],
            "set = 'seed=1': seed is given twice; give it once, as seed=[0,1]",
        ),
        (["--set", "seed"], "set = 'seed': must be NAME=VALUE, as seed=[0,1]"),
    ],
)
def test_bad_input_is_refused_before_the_first_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], said: str
) -> None:
    monkeypatch.setattr("deploy.study.run_pool.ProcessPoolExecutor.submit", None)
    code, table, errors = command(write(tmp_path, EXPERIMENT), *words)
    assert (code, table, errors.count("\n")) == (2, "", 1)
    assert said in errors


def begun(tmp_path: Path, out: Path) -> subprocess.Popen[str]:
    """A sweep of eight runs in a process group of its own, of which one at least is finished."""
    text = EXPERIMENT.replace("seed = [0, 1]", "seed = [0, 1]\nsteps = [1, 5000]").replace("steps = 6\n", "")
    path = write(tmp_path, text.replace('"em"', '"office"'))
    sweeping = subprocess.Popen(
        [*MURMUR, "sweep", path, "--jobs", "2", "--set", "robots=12", "--out", out],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])},
    )  # fmt: skip
    while not out.exists() or not out.read_text():
        assert sweeping.poll() is None
        time.sleep(0.1)
    return sweeping


def assert_none_is_left(group: int) -> None:
    deadline = time.monotonic() + 10
    with pytest.raises(ProcessLookupError):
        while time.monotonic() < deadline:
            os.killpg(group, 0)
            time.sleep(0.1)


def test_ctrl_c_stops_a_sweep_at_once_and_keeps_what_is_finished(tmp_path: Path) -> None:
    out = tmp_path / "all.jsonl"
    sweeping = begun(tmp_path, out)
    os.killpg(sweeping.pid, signal.SIGINT)
    asked = time.monotonic()
    table, errors = sweeping.communicate(timeout=30)
    assert sweeping.returncode == 130 and time.monotonic() - asked < 10
    assert_none_is_left(sweeping.pid)
    assert f"stopped; the same command goes on with {out}" in errors and "Traceback" not in errors
    kept = len(out.read_text().splitlines())
    assert 0 < kept < 8 and f"means of {kept} of 8 runs" in table


def test_nothing_outlives_a_sweep_that_is_killed(tmp_path: Path) -> None:
    sweeping = begun(tmp_path, tmp_path / "all.jsonl")
    sweeping.kill()
    sweeping.communicate(timeout=30)
    assert_none_is_left(sweeping.pid)
