"""The runs of an experiment: each runs once, is kept under its key, and is validated before the first run."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from deploy.scenario.errors import ScenarioError
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import parse
from deploy.study import experiment as experiments
from deploy.study import measures, runs
from deploy.study.results import Results
from deploy.study.runs import Case
from tests.deploy.study.small_experiment import EXPERIMENT, write
from tests.test_shape import imports, modules
from worldsim import generators, maps


def test_every_combination_of_grid_and_variants_is_run_once(tmp_path: Path) -> None:
    todo = runs.cases(experiments.read(write(tmp_path, EXPERIMENT)))
    places = {(c.place["robots"], c.place["seed"], c.place["variant"]) for c in todo}
    assert len(todo) == len(places) == 8
    assert len({c.key for c in todo}) == 8
    assert all(c.scenario.bus == "memory" and c.scenario.map == "em" for c in todo)
    assert {c.scenario.map_encoding for c in todo if c.place["variant"] == "scans"} == {"scans"}


def test_the_cases_of_a_building_share_one_drawing_of_its_map(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[tuple[str, int]] = []
    draw = generators.make

    def noted(name: str, seed: int = 0, **options: float) -> maps.Map:
        drawn.append((name, seed))
        return draw(name, seed, **options)

    monkeypatch.setattr(generators, "make", noted)
    small(tmp_path, "[grid]\nmap = ['em', 'office']\nrobots = [1, 2]\nspeed = [0.3, 0.5]\n")
    assert sorted(drawn) == [("em", 0), ("office", 0)]


class Ourselves:
    """Makes runs in this process; `made` counts them."""

    def __init__(self) -> None:
        self.made: list[str] = []

    def each(self, todo: Sequence[Any], run: Callable[[Any], Any]) -> Iterator[tuple[Any, Any]]:
        for case in todo:
            self.made.append(case.key)
            yield case, run(case)


def small(tmp_path: Path, text: str = EXPERIMENT, **settings: Any) -> list[Case]:
    return runs.cases(experiments.override(experiments.read(write(tmp_path, text)), settings))


def test_finished_runs_are_kept_and_not_repeated(tmp_path: Path) -> None:
    keep, us = tmp_path / "kept.parquet", Ourselves()
    todo = small(tmp_path, robots=1)
    for some in (todo[:2], todo[:2], todo):
        with Results(keep) as results:
            runs.make(some, results, us)
            found = runs.StudyRuns(todo, results).rows
    assert us.made == [case.key for case in todo]
    assert [each["place"] for each in found] == [case.place for case in todo]
    assert [each["seed"] for each in found] == [case.scenario.seed for case in todo]
    assert all(each["steps"] == each["most_steps"] == 6 for each in found)
    assert len(pl.read_parquet(keep)) == len(todo)


def test_tables_of_runs_notice_changes_of_all_modules_that_measures_import() -> None:
    trees, found, todo = modules(), set[str](), [measures.__name__]
    while todo:
        if (name := todo.pop()) in trees and name not in found:
            found.add(name)
            todo += imports(trees[name], set(trees))
    files = {f"{name.replace('.', '/')}.py" for name in found}
    assert [file for file in files if not file.startswith(runs.SOURCES)] == []


def test_equal_runs_are_made_once(tmp_path: Path) -> None:
    us = Ourselves()
    todo = small(
        tmp_path, EXPERIMENT.replace('map_encoding = "scans"', 'map_encoding = "polygons"'), robots=1, seed=0
    )
    with Results(None) as results:
        runs.make(todo, results, us)
        found = runs.StudyRuns(todo, results).rows
    assert len(us.made) == 1 and [each["place"]["variant"] for each in found] == ["polygons", "scans"]


def test_a_run_that_fails_is_a_row_with_its_error_and_the_others_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def falls_over(plan: Plan) -> dict[str, Any]:
        if plan.scenario.seed == 0:
            raise RuntimeError("it fell over")
        return {"steps": 3}

    monkeypatch.setitem(measures.MEASURES, "exploration", falls_over)
    todo, keep, us = small(tmp_path, robots=1), tmp_path / "kept.parquet", Ourselves()
    with Results(keep) as results:
        runs.make(todo, results, us)
        assert runs.StudyRuns(todo, results).failures == {"RuntimeError: it fell over": 2}
        assert {row["place"]["seed"] for row in runs.StudyRuns(todo, results).rows} == {1}
    with Results(keep) as results:
        runs.make(todo, results, us)
        assert len(us.made) == 4
        monkeypatch.setitem(measures.MEASURES, "exploration", lambda plan: {"steps": 4})
        runs.make(todo, results, us, retry=True)
        assert len(us.made) == 6 and not runs.StudyRuns(todo, results).failures


def test_runs_of_other_code_are_repeated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    us = Ourselves()
    with Results(None) as results:
        runs.make(small(tmp_path, robots=1, seed=0), results, us)
        monkeypatch.setattr(runs, "_sources", lambda: "other")
        todo = small(tmp_path, robots=1, seed=0)
        runs.make(todo, results, us)
        assert len(us.made) == 4 and len(results.frame) == 2


def test_the_code_hash_covers_user_defined_map_encodings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    silent = (
        "from agent.encodings.none import NoEncoding\n\n\nclass Silent(NoEncoding):\n    name = 'silent'\n"
    )
    for module, more in (("first_silent", ""), ("second_silent", "    loud = False\n")):
        (tmp_path / f"{module}.py").write_text(silent + more)
    monkeypatch.syspath_prepend(tmp_path)
    codes = {
        runs.code_of(parse({"map_encoding": map_encoding}))
        for map_encoding in ("none", "first_silent:Silent", "second_silent:Silent")
    }
    assert len(codes) == 3


def test_a_run_s_key_depends_on_all_settings_the_map_and_the_measure(tmp_path: Path) -> None:
    (plain, *_), (other, *_), (slow, *_) = (
        small(tmp_path, **settings)
        for settings in ({"seed": 0}, {"seed": 0, "map": "jh-like"}, {"seed": 0, "speed": 0.2})
    )
    assert plain.key == small(tmp_path, seed=0)[0].key
    measured = runs.identity(plain.scenario, "something else", b"")
    assert len({plain.key, other.key, slow.key, measured}) == 4


def test_maps_of_files_travel_with_their_cases(tmp_path: Path) -> None:
    maps.save(generators.make("em", seed=0), tmp_path / "mine.yaml")
    (case, *_) = small(tmp_path, EXPERIMENT.replace('"em"', '"mine.yaml"'), robots=1, seed=0)
    (tmp_path / "mine.yaml").unlink()
    row = runs.run_case(case)
    (generated, *_) = small(tmp_path, robots=1, seed=0)
    assert row["error"] is None
    assert (generated.world, row["digest"]) == (b"", runs.run_case(generated)["digest"])


def test_dotted_keys_of_the_grid_set_one_key_of_a_table(tmp_path: Path) -> None:
    text = "[base]\nstrategy = 'burgard'\n[grid]\n'options.beta' = [0.1, 1.0]\n"
    options = [case.scenario.options for case in small(tmp_path, text)]
    assert options == [{"beta": 0.1}, {"beta": 1.0}]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"robots": [1, 0]}, "robots = 0, seed = 0, variant = polygons): robots = 0: "),
        ({"seed": None}, "seed = None: must be a whole number"),
        ({"seed": []}, "seed = []: is an empty list; give at least one value"),
        ({"variant": 3}, "--variant NAME chooses"),
        ({"robtos": 3}, "robtos: unknown setting"),
        ({"map": "nope"}, "variant = polygons): unknown map 'nope'"),
        ({"map": "nope.yaml"}, "nope.yaml: no such file"),
        ({"start": [0, 0]}, "start on map em"),
        ({"bus": "zenoh"}, "bus = 'zenoh': sweeps run on the memory bus; leave it out"),
    ],
)
def test_an_invalid_case_is_rejected_with_its_position(
    tmp_path: Path, settings: dict[str, Any], message: str
) -> None:
    experiment = experiments.read(write(tmp_path, EXPERIMENT))
    with pytest.raises(ScenarioError) as caught:
        runs.cases(experiments.override(experiment, settings))
    assert message in str(caught.value) and "\n" not in str(caught.value)
