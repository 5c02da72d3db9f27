"""Searches for weights: what they try, what they keep, how they continue, and which seeds they may use."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from deploy.study import experiment as experiments
from deploy.study.results import Results
from deploy.study.tuning import Search, Tuning, default_weights, tune
from worldsim.generators.seeds import is_test_seed

RECORD = Path(__file__).parents[3] / "docs" / "results" / "repairmen" / "weights.toml"
SMALL = {"robots": 2, "bandwidth": "unlimited", "map_options": {"resolution": 0.4}, "map_encoding": "scans"}


class Ourselves:
    """Makes runs in this process, and counts them; stops after `most`."""

    def __init__(self, most: int = 10**9) -> None:
        self.made = 0
        self._most = most

    def each(self, todo: Sequence[Any], run: Callable[[Any], Any]) -> Iterator[tuple[Any, Any]]:
        for case in todo:
            if self.made == self._most:
                raise KeyboardInterrupt
            self.made += 1
            yield case, run(case)


def small(**changes: Any) -> Search:
    given: dict[str, Any] = {
        "strategy": "meier", "maps": ["em"], "seeds": [0, 1], "check_seeds": [2, 3], "evaluations": 5,
        "settings": SMALL,
    }  # fmt: skip
    return Search(**given | changes)


@pytest.fixture(scope="module")
def done() -> Tuning:
    return tune(small(), Results(None), Ourselves())


def test_the_first_trial_has_the_default_weights_and_the_best_one_the_least_score(done: Tuning) -> None:
    assert done.trials[0].weights == default_weights("meier")
    assert done.trials[0].score == 1
    assert done.best.score == min(trial.score for trial in done.trials)
    assert 2 <= len(done.trials) <= 5
    assert len({str(trial.weights) for trial in done.trials}) == len(done.trials)


def test_each_trial_changes_one_weight_of_the_best_one_so_far_by_the_step() -> None:
    search = small(strategy="repairmen", evaluations=6, seeds=[0], check_seeds=[])
    done = tune(search, Results(None), Ourselves())
    for trial in done.trials[1:]:
        earlier = done.trials[: trial.number]
        changes = [
            [
                trial.weights[name] / value
                for name, value in each.weights.items()
                if trial.weights[name] != value
            ]
            for each in earlier
        ]
        assert any(len(change) == 1 and change[0] in (0.5, 2.0) for change in changes)


def test_a_stopped_search_continues_and_ends_as_one_that_was_not_stopped(
    done: Tuning, tmp_path: Path
) -> None:
    table = tmp_path / "runs.parquet"
    with pytest.raises(KeyboardInterrupt), Results(table) as results:
        tune(small(), results, Ourselves(most=3))
    rest = Ourselves()
    with Results(table) as results:
        continued = tune(small(), results, rest)
    assert continued.table.equals(done.table)
    again = Ourselves()
    with Results(table) as results:
        tune(small(), results, again)
    assert rest.made > 0 and again.made == 0


def test_the_best_weights_run_on_the_check_seeds(done: Tuning) -> None:
    assert done.check is not None
    assert sorted(done.check.ratios) == [("em", 2), ("em", 3)]
    assert done.check.weights == done.best.weights
    assert f"{done.check.score:.3f}" in done.sentence and "check seeds 2, 3" in done.sentence


def test_runs_that_do_not_finish_count_with_the_maximum_number_of_steps() -> None:
    done = tune(small(settings={**SMALL, "steps": 4}), Results(None), Ourselves())
    assert {trial.score for trial in done.trials} == {1.0}
    assert done.check is None
    assert done.sentence == "No weights were better than the defaults in 5 trials."


def test_without_check_seeds_the_sentence_has_the_score_of_the_search(done: Tuning) -> None:
    found = replace(done, best=done.trials[1], check=None)
    score = f"{done.trials[1].score:.3f}"
    sentence = (
        f"Trial 1 takes {score} of the default weights' steps in the search; there were no check seeds."
    )
    assert found.sentence == sentence


def test_the_record_of_a_search_has_its_weights_maps_and_seeds(done: Tuning) -> None:
    record = tomllib.loads(done.record)
    assert record["weights"] == done.best.weights
    assert (record["strategy"], record["maps"], record["seeds"]) == ("meier", ["em"], [0, 1, 2, 3])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"seeds": [3, 1000]}, "seed 1000: is a test seed, on which nothing may be tuned"),
        ({"check_seeds": [1234]}, "seed 1234: is a test seed"),
        ({"check_seeds": [1, 2]}, "check_seeds: 1 is a seed of the search as well"),
        ({"only": ["gamma"]}, "meier has no weight 'gamma'; there are: occ_max, beta"),
        ({"settings": {"map_seed": 1000}}, "map_seed = 1000: is chosen by the search; remove it"),
        ({"settings": {"options.beta": 2.0}}, r"options\.beta = 2\.0: is chosen by the search; remove it"),
        ({"maps": []}, r"maps = \[\]: is an empty list; give at least one value"),
        ({"seeds": []}, r"seeds = \[\]: is an empty list; give at least one value"),
        ({"strategy": "nope"}, "no strategy is called 'nope'"),
        ({"strategy": "nearest"}, "nearest has no numeric options to search"),
    ],
)
def test_a_search_rejects_test_seeds_and_what_it_cannot_search(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        small(**changes)


# The split of seeds


def test_the_shipped_weights_of_repairmen_are_those_of_their_record_and_of_training_seeds() -> None:
    record = tomllib.loads(RECORD.read_text())
    assert record["weights"] == default_weights("repairmen")
    assert record["seeds"]
    assert not any(map(is_test_seed, record["seeds"]))


@pytest.mark.parametrize("path", sorted(experiments.SHIPPED.glob("*.toml")), ids=lambda path: path.stem)
def test_shipped_experiments_run_training_seeds_unless_the_user_asks_for_test_seeds(path: Path) -> None:
    experiment = experiments.read(path)
    layers = [experiment.base, *experiment.variants.values()]
    layers += [{key: values} for key, values in experiment.grid.items()]
    for layer in layers:
        for key in ("seed", "map_seed"):
            values = layer.get(key, [])
            assert not any(map(is_test_seed, values if isinstance(values, list) else [values]))
