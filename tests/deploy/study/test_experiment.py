"""Experiments: grids, variants, derived keys, overrides, and errors."""

from __future__ import annotations

from pathlib import Path

import pytest

from agent.strategies.registry import strategies
from deploy.scenario.errors import ScenarioError
from deploy.scenario.scenario import load
from deploy.scenario.thesis import thesis_settings
from deploy.study import experiment as experiments
from deploy.study import runs
from tests.deploy.study.small_experiment import EXPERIMENT, write
from worldsim import generators, maps


def test_variants_may_be_chosen(tmp_path: Path) -> None:
    experiment = experiments.read(write(tmp_path, EXPERIMENT))
    assert {case.place["variant"] for case in runs.cases(experiments.choose(experiment, ["scans"]))} == {
        "scans"
    }
    assert experiments.choose(experiment, []) == experiment
    with pytest.raises(ScenarioError, match="no variant is called 'scan'; there are: 'polygons', 'scans'"):
        experiments.choose(experiment, ["scan"])
    text = EXPERIMENT.replace('"bytes.total"', '"bytes.total relative to scans"')
    with pytest.raises(ScenarioError, match="needs 'scans' for"):
        experiments.choose(experiments.read(write(tmp_path, text)), ["polygons"])


def test_single_values_replace_lists_of_the_grid_as_lists_of_one(tmp_path: Path) -> None:
    experiment = experiments.read(write(tmp_path, 'grid.map = ["em", "office"]\ngrid.seed = [0, 1]\n'))
    other = experiments.override(experiment, {"map": "jh-like", "seed": 3, "robots": 2})
    assert [(c.scenario.map, c.scenario.seed, c.scenario.robots) for c in runs.cases(other)] == [
        ("jh-like", 3, 2)
    ]


def test_maps_are_found_beside_the_experiment_and_those_of_flags_in_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, here = tmp_path / "there", tmp_path / "here"
    for place, name in ((folder, "a"), (folder, "b"), (here, "c")):
        place.mkdir(exist_ok=True)
        maps.save(generators.make("em", seed=0), place / f"{name}.yaml")
    monkeypatch.chdir(here)
    experiment = experiments.read(write(folder, 'grid.map = ["a.yaml", "b.yaml", "em"]\n'))
    assert [c.scenario.map for c in runs.cases(experiment)] == [
        str(folder / "a.yaml"), str(folder / "b.yaml"), "em"
    ]  # fmt: skip
    assert [c.scenario.map for c in runs.cases(experiments.override(experiment, {"map": "c.yaml"}))] == [
        "c.yaml"
    ]
    for text in ('base.map = "a.yaml"\n', '[[variant]]\nname = "it"\nmap = "a.yaml"\n'):
        (case,) = runs.cases(experiments.read(write(folder, text)))
        assert case.scenario.map == str(folder / "a.yaml")


def test_an_experiment_can_extend_a_scenario(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text("map = 'em'\nrobots = 2\n[options]\nbeta = 3.0\nreplan = 'at-goal'\n")
    text = "scenario = 'mine.toml'\n[base]\nstrategy = 'burgard'\nrobots = 4\n'options.beta' = 2.0\n"
    (case,) = runs.cases(experiments.read(write(tmp_path, text)))
    assert (case.scenario.map, case.scenario.robots) == ("em", 4)
    assert case.scenario.options == {"beta": 2.0, "replan": "at-goal"}
    (shipped,) = runs.cases(experiments.read(write(tmp_path, "scenario = 'burgard.toml'\n")))
    assert shipped.scenario.strategy == "burgard" and shipped.scenario.interference == 1.0
    with pytest.raises(ScenarioError, match=r"nowhere\.toml: no such file"):
        experiments.read(write(tmp_path, "scenario = 'nowhere.toml'\n"))
    with pytest.raises(ScenarioError, match="scenario = 3: must be text"):
        experiments.read(write(tmp_path, "scenario = 3\n"))


def test_an_experiment_can_select_the_thesis_plain_rules_and_override_them(tmp_path: Path) -> None:
    text = """[base]
thesis = true
polygons = { lazy = true, exact_error = true }
[[variant]]
name = "thesis"
[[variant]]
name = "ours"
thesis = false
"""
    plain, ours = (case.scenario for case in runs.cases(experiments.read(write(tmp_path, text))))
    assert plain.dissemination == "thesis" and plain.options == {"herding": False}
    wanted = load(None, {**thesis_settings({}), "polygons.lazy": True, "polygons.exact_error": True})
    assert plain.polygons == wanted.polygons
    assert (ours.dissemination, ours.options, ours.polygons.mixed_first) == ("gossip", {}, True)
    with pytest.raises(ScenarioError, match="thesis = 1: must be true or false"):
        runs.cases(experiments.read(write(tmp_path, "[base]\nthesis = 1\n")))


@pytest.mark.parametrize("path", sorted(experiments.SHIPPED.glob("*.toml")), ids=lambda path: path.stem)
def test_shipped_experiments_are_found_by_name_and_valid(path: Path) -> None:
    experiment = experiments.read(Path(path.name))
    assert experiment == experiments.read(path)
    assert runs.cases(experiments.override(experiment, {"seed": 0, "map": "em"}))


def test_an_unknown_experiment_is_rejected_with_the_known_ones() -> None:
    with pytest.raises(
        ScenarioError,
        match=r"experiment none\.toml: no such file, and no shipped experiment; there are: claim-A1.toml",
    ):
        experiments.read(Path("none.toml"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name = 'nothing'\n", "nothing to run"),
        ("base = 3\n", "base = 3: must be a table"),
        (
            "[grid]\nrobots = [3]\n[table]\nvalues = ['steps relative to scans']\n",
            "no variant is called 'scans'; there are: plain",
        ),
        ("[grid]\nrobots = [3]\n[table]\nvalues = ['steps / seed / robots']\n", "at most one"),
        ("[grid]\nrobots = 3\n", "grid.robots = 3: must be a list"),
        ("[gird]\nrobots = [3]\n", "gird: unknown setting; did you mean grid?"),
        ("[grid]\nrobots = [3]\n[table]\nrows = ['seed']\n", "'seed', which is not in the grid"),
        ("[[variant]]\nspeed = 1.0\n", "variant.0.name is missing"),
        ("name = ", "not TOML"),
        (
            "[grid]\nseed = [0]\n[follow]\nmap_seed = 'seeds'\n",
            "follow.map_seed = 'seeds': is not in the grid",
        ),
        (
            "[grid]\nseed = [0]\nmap_seed = [1]\n[follow]\nmap_seed = 'seed'\n",
            "the grid sets map_seed as well",
        ),
        ("[base]\nrobots = 2\n[grid]\nrobots = [3]\n", "base.robots: the grid sets robots as well"),
        ("[grid]\nmap = ['em', { map = 'em', map_seed = 1 }]\n", "contains 'em' twice"),
        (
            "variant = [{ name = 'a', map_seed = 1 }]\n[grid]\nmap = [{ map = 'em', map_seed = 1 }]\n",
            "variant 'a' sets map_seed, which the grid sets",
        ),
        ("[base]\n[table]\ninterval = 3\n", "table.interval = 3: must be true or false"),
        ("seeds = 2\n[grid]\nseed = [3]\n", "seeds and grid.seed: set only one of them"),
        ("seeds = 2\n[base]\nseed = 3\n", "seeds and base.seed: set only one of them"),
        ("[grid]\nseed = []\n", "grid.seed = []: is an empty list; give at least one value"),
        ("[grid]\nseed = [0, 1, 0]\n", "contains 0 twice"),
        ("variant = []\n", "variant = []: must have at least one entry"),
        ("variant = 3\n", "variant = 3: must be a list"),
        ("variant = [{ name = 'a' }, { name = 'a' }]\n", "two variants are called 'a'"),
        (
            "variant = [{ name = 'a', robots = 1 }]\n[grid]\nrobots = [2, 3]\n",
            "variant 'a' sets robots, which the grid sets",
        ),
        ("[base]\n[table]\nrows = 3\n", "table.rows = 3: must be a list"),
        (
            "[grid]\nseed = [1]\n[table]\nrows = [['seed']]\n",
            "table.rows.0 = ['seed']: must be text",
        ),
        ("[base]\n[table]\nvalues = [3]\n", "table.values.0 = 3: must be text"),
        (
            "[base]\n[table]\nvalues = 'steps'\n",
            "table.values = 'steps': must be a list",
        ),
        ("[base]\n[table]\nvalues = []\n", "table.values = []: must have at least one entry"),
        ("[base]\n[table]\nvalues = ['stepz']\n", "'stepz' is not a metric; there are: steps, coverage"),
        (
            "[base]\n[table]\nvalue = ['steps']\n",
            "table.value: unknown setting; did you mean values? There are: rows, columns, values",
        ),
    ],
)
def test_an_invalid_experiment_is_rejected_by_name(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ScenarioError, match=r"small\.toml") as caught:
        experiments.read(write(tmp_path, text))
    assert message in str(caught.value)


def test_a_setting_that_every_variant_overrides_is_rejected(tmp_path: Path) -> None:
    experiment = experiments.read(write(tmp_path, EXPERIMENT))
    experiments.override(experiment, {"map_encoding": "scans"})
    with pytest.raises(ScenarioError, match="--set map_encoding: has no effect"):
        experiments.override(experiments.choose(experiment, ["scans"]), {"map_encoding": "polygons"})


def test_a_key_of_a_table_that_every_variant_overrides_is_rejected(tmp_path: Path) -> None:
    text = "base.strategy = 'meier'\n" + "".join(
        f"[[variant]]\nname = '{name}'\noptions = {{ beta = 1.0 }}\n" for name in "ab"
    )
    with pytest.raises(
        ScenarioError, match=r"--set options\.forget: has no effect, because .* sets options$"
    ):
        experiments.override(experiments.read(write(tmp_path, text)), {"options.forget": 3})


@pytest.mark.parametrize("key", ["laser.preset", "speed"])
def test_a_list_for_a_key_outside_the_grid_adds_it_to_the_grid_and_to_the_rows(
    tmp_path: Path, key: str
) -> None:
    values = {"laser.preset": ["utm-30lx", "rplidar-a1"], "speed": [0.25, 0.5]}[key]
    experiment = experiments.override(experiments.read(write(tmp_path, "grid.map = ['em']\n")), {key: values})
    assert experiment.table.rows == ["map", key]
    assert [case.place[key] for case in runs.cases(experiment)] == values


def test_a_table_in_the_grid_sets_all_its_keys_and_goes_by_its_own(tmp_path: Path) -> None:
    text = "grid.map = ['em', { map = 'jh-like', map_options = { resolution = 0.2 }, speed = 0.4 }]\n"
    plain, coarse = runs.cases(experiments.read(write(tmp_path, text)))
    assert (plain.place["map"], plain.scenario.speed, plain.scenario.map_options) == ("em", 0.5, {})
    assert (coarse.place["map"], coarse.scenario.speed) == ("jh-like", 0.4)
    assert coarse.scenario.map_options == {"resolution": 0.2}


def test_a_dotted_name_whose_parent_is_no_table_is_rejected(tmp_path: Path) -> None:
    text = "[base]\npeople = 3\n'people.number' = 2\n"
    with pytest.raises(ScenarioError, match=r"people = 3: must be a table, for 'people\.number' sets"):
        runs.cases(experiments.read(write(tmp_path, text)))


def test_derived_keys_follow_the_grid_s_values_and_their_overrides(tmp_path: Path) -> None:
    text = "[grid]\nmap = ['office']\nseed = [0, 1]\n[follow]\nmap_seed = 'seed'\n"
    experiment = experiments.override(experiments.read(write(tmp_path, text)), {"seed": [4, 7]})
    assert [(c.scenario.seed, c.scenario.map_seed) for c in runs.cases(experiment)] == [(4, 4), (7, 7)]


def test_every_shipped_strategy_has_an_experiment_with_finished_runs() -> None:
    named = {
        name
        for path in experiments.SHIPPED.glob("finish-*.toml")
        for name in experiments.read(path).grid["strategy"]
    }
    assert named == {name for name, kind in strategies().items() if kind.__module__.startswith("agent.")}
