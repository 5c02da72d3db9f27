"""Claims: the syntax of rules, their statistical tests, and the verdict."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest

from deploy.scenario.errors import ScenarioError
from deploy.study import experiment as experiments
from deploy.study.claims import HOLDS, IN_PART, NOT, UNDECIDED, judge
from tests.deploy.study.small_experiment import EXPERIMENT, write

HEAD = '[claim]\nid = "B1"\npaper = "a paper"\nstatement = "scans are faster"\n'
FASTER = """
[[claim.rule]]
statement = "scans are faster"
metric = "steps"
compare = { variant = "scans" }
to = { variant = "polygons" }
expect = "ratio < 1"
by = ["robots"]
"""


def verdict(tmp_path: Path, rules: str, rows: list[dict[str, Any]]) -> Any:
    claim = experiments.read(write(tmp_path, EXPERIMENT + HEAD + rules)).claim
    assert claim is not None
    return judge([(claim.rule, rows)])


def rows(
    *, factors: dict[int, float], seeds: int = 8, noise: float = 0.05, **more: Any
) -> list[dict[str, Any]]:
    """Runs of which scans take `factors` of the steps, by number of robots."""
    rolls = random.Random(3)
    return [
        {
            "place": {"robots": robots, "seed": seed, "variant": name},
            "steps": (100 + 40 * seed) * (factor if name == "scans" else 1) * (1 + rolls.uniform(-noise, noise)),
            "finished": True, "coverage": 1.0, **more,
        }
        for robots, factor in factors.items() for seed in range(seeds) for name in ("polygons", "scans")
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("factors", "word"),
    [
        ({1: 0.7, 2: 0.8}, HOLDS),
        ({1: 0.7, 2: 1.3}, IN_PART),
        ({1: 0.7, 2: 1.0}, IN_PART),
        ({1: 1.0, 2: 1.3}, NOT),
        ({1: 1.0, 2: 1.0}, UNDECIDED),
    ],
)
def test_the_verdict_follows_from_the_tests_of_all_cells(
    tmp_path: Path, factors: dict[int, float], word: str
) -> None:
    found = verdict(tmp_path, FASTER, rows(factors=factors))
    assert found.result == word
    assert [finding.cell for finding in found.findings] == [{"robots": 1}, {"robots": 2}]
    assert found.findings[0].effect.mean == pytest.approx(factors[1], rel=0.05)


def test_pairs_with_an_unfinished_run_are_left_out_and_counted(tmp_path: Path) -> None:
    runs = rows(factors={1: 0.7})
    runs[1]["coverage"] = 0.5
    (finding,) = verdict(tmp_path, FASTER, runs).findings
    assert (finding.effect.n, finding.left_out, finding.verdict) == (7, 1, HOLDS)
    (whole,) = verdict(tmp_path, FASTER + "all_runs = true\n", runs).findings
    assert (whole.effect.n, whole.left_out) == (8, 0)


def test_without_runs_nothing_is_decided(tmp_path: Path) -> None:
    found = verdict(tmp_path, FASTER, [])
    assert found.result == UNDECIDED and [finding.effect.n for finding in found.findings] == [0]
    assert verdict(tmp_path, FASTER, rows(factors={1: 0.7})[:1]).result == UNDECIDED


def test_many_tests_need_more_evidence_than_one(tmp_path: Path) -> None:
    alone = rows(factors={1: 0.9}, seeds=5, noise=0.1)
    (finding,) = verdict(tmp_path, FASTER, alone).findings
    many = rows(factors={1: 0.9, 2: 1.0}, seeds=5, noise=0.1)
    assert verdict(tmp_path, FASTER, many).findings[0].p == pytest.approx(2 * finding.p)


@pytest.mark.parametrize(
    ("rule", "word"),
    [
        ('metric = "steps"\nexpect = "grows over seed"', HOLDS),
        ('metric = "steps"\nexpect = "falls over seed"', NOT),
        ('metric = "steps"\nexpect = "grows over robots"', UNDECIDED),
        ('metric = "steps"\nexpect = "value in 50..1000"', HOLDS),
        ('metric = "steps"\nexpect = "value < 20"', NOT),
        ('metric = "finished"\nexpect = "value > 0.5"', HOLDS),
        ('metric = "coverage"\nexpect = "value > 0.999"\nexact = true', HOLDS),
        ('metric = "steps"\nexpect = "order of seed"\nranks = { 0 = 1, 1 = 2, 2 = 3, 3 = 4, 4 = 5 }', HOLDS),
        ('metric = "steps"\nexpect = "ratio > 1.2"\ncompare = { seed = 4 }\nto = { seed = 0 }', HOLDS),
        ('metric = "spread of steps"\nexpect = "difference < 0"\ncompare = { variant = "scans" }\n'
         'to = { variant = "polygons" }', HOLDS),
        ('metric = "steps"\nexpect = "grows over seed"\nwhere = { robots = [7] }', UNDECIDED),
    ],
)  # fmt: skip
def test_every_form_of_expectation(tmp_path: Path, rule: str, word: str) -> None:
    runs = rows(factors={1: 0.3, 2: 0.3})
    assert verdict(tmp_path, f'[[claim.rule]]\nstatement = "so"\n{rule}\n', runs).result == word


@pytest.mark.parametrize(
    ("rule", "message"),
    [
        ('metric = "stepz"\nexpect = "value < 3"', "'stepz' is not a metric"),
        ('metric = "steps"\nexpect = "is less"', "expect = 'is less': must be one of 'ratio < 1'"),
        ('metric = "steps"\nexpect = "ratio < 1"', "compare and to are needed for a ratio"),
        (
            'metric = "steps"\nexpect = "value < 1"\ncompare = { seed = 1 }\nto = { seed = 0 }',
            "compare and to are needed",
        ),
        ('metric = "steps"\nexpect = "ratio < 1"\ncompare = { seed = 1 }\nto = { robots = 1 }', "the same keys"),
        ('metric = "steps"\nexpect = "falls over range"', "not in the grid; there are: robots, seed"),
        ('metric = "steps"\nexpect = "value < 1"\nby = ["range"]', "names 'range', which is not in the grid"),
        ('metric = "steps"\nexpect = "value < 1"\nwhere = { seed = 1 }', "where.seed = 1: must be a list"),
        ('metric = "steps"\nexpect = "order of seed"', "ranks gives the expected order"),
        ('metric = "steps"', "expect is missing"),
        ('metric = 3', "metric = 3: must be text"),
        ('fig = "steps"', "claim.rule.0.fig: unknown setting; there are: statement, metric"),
        ('metric = "steps"\nexpect = "ratio < 1"\ncompare = { variant = "x" }\nto = { variant = "scans" }',
         "no variant is called 'x'; there are: polygons, scans"),
    ],
)  # fmt: skip
def test_an_invalid_rule_is_rejected(tmp_path: Path, rule: str, message: str) -> None:
    with pytest.raises(ScenarioError, match=r"small\.toml") as caught:
        verdict(tmp_path, f'[[claim.rule]]\nstatement = "so"\n{rule}\n', [])
    assert message in str(caught.value)


def test_a_claim_needs_a_name_and_rules(tmp_path: Path) -> None:
    for text, message in (
        (HEAD, "claim.rule is missing"),
        ("[claim]\nid = 'B1'\n", "claim.paper is missing"),
    ):
        with pytest.raises(ScenarioError, match=message):
            experiments.read(write(tmp_path, EXPERIMENT + text))
