"""The runs of an experiment: each made once, kept, told apart, and refused before the first where it cannot be."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from deploy.scenario.scenario import ScenarioError, parse
from deploy.study import experiment as experiments
from deploy.study import runs
from deploy.study.tables import has_finished
from tests.deploy.study.small_experiment import EXPERIMENT, write
from worldsim import generators


def test_every_combination_of_grid_and_variants_is_run_once(tmp_path: Path) -> None:
    todo = runs.cases(experiments.read(write(tmp_path, EXPERIMENT)))
    places = {(c.place["robots"], c.place["seed"], c.place["variant"]) for c in todo}
    assert len(todo) == len(places) == 8
    assert len({c.key for c in todo}) == 8
    assert all(c.scenario.bus == "memory" and c.scenario.map == "em" for c in todo)
    assert {c.scenario.exchange for c in todo if c.place["variant"] == "scans"} == {"laser"}


def test_finished_runs_are_kept_and_not_made_again(tmp_path: Path) -> None:
    keep = tmp_path / "kept.jsonl"
    todo = runs.cases(experiments.override(experiments.read(write(tmp_path, EXPERIMENT)), {"robots": 1}))
    first = list(runs.run(todo[:2], 1, keep))
    before = keep.read_text()
    again = list(runs.run(todo[:2], 1, keep))
    assert again == first and keep.read_text() == before
    outcomes = list(runs.run(todo, 1, keep))
    found = runs.summaries(todo, outcomes)
    assert outcomes[:2] == first and len(keep.read_text().splitlines()) == len(todo)
    assert [each["place"] for each in found] == [case.place for case in todo]
    assert [each["seed"] for each in found] == [case.scenario.seed for case in todo]


def test_equal_runs_are_made_once(tmp_path: Path) -> None:
    text = EXPERIMENT.replace('exchange = "laser"', 'exchange = "polygon"')
    todo = runs.cases(experiments.override(experiments.read(write(tmp_path, text)), {"robots": 1, "seed": 0}))
    outcomes = list(runs.run(todo, 1))
    assert len(todo) == 2 and len(outcomes) == 1
    assert [each["place"]["variant"] for each in runs.summaries(todo, outcomes)] == ["polygons", "scans"]


def test_a_run_is_another_with_any_other_setting_map_version_or_code(monkeypatch: pytest.MonkeyPatch) -> None:
    settings, world = {"map": "em", "bus": "memory"}, generators.make("em", seed=0)
    same = runs.identity(parse(settings), world)
    assert same == runs.identity(parse(settings | {"seed": 0}), generators.make("em", seed=0))
    others = [
        runs.identity(parse(settings | {"polygon": {"lazy": False}}), world),
        runs.identity(parse(settings), generators.make("jh-like", seed=0)),
    ]
    with monkeypatch.context() as patch:
        patch.setattr(runs, "versions", lambda: {"python": "2"})
        others.append(runs.identity(parse(settings), world))
    with monkeypatch.context() as patch:
        patch.setattr(runs, "_code", lambda: "other")
        others.append(runs.identity(parse(settings), world))
    assert len({same, *others}) == 5


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
    experiment = experiments.read(write(tmp_path, EXPERIMENT))
    with pytest.raises(ScenarioError) as caught:
        runs.cases(experiments.override(experiment, settings))
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_without_leaders_the_team_stalls_where_with_leaders_it_finishes() -> None:
    claim = experiments.override(experiments.read(Path("claim-L1.toml")), {"seed": 0})
    todo = runs.cases(claim)
    done = runs.summaries(todo, list(runs.run(todo, 1)))
    assert {one["place"]["variant"]: has_finished(one) for one in done} == {
        "leaders": True,
        "potential-field": False,
    }
