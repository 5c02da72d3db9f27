"""The table of first looks: what is run, and how it is summed up."""

from __future__ import annotations

import pytest
from rich.console import Console

from deploy.scenario.scenario import parse
from deploy.study.claims import CLAIMS, Run, run, runs_of, table

BY_NAME = {claim.name: claim for claim in CLAIMS}


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.name)
def test_every_variant_is_a_scenario_that_can_be_run(claim: object) -> None:
    claim = BY_NAME[claim.name]  # type: ignore[attr-defined]
    for settings in claim.variants.values():
        parse(claim.scenario | settings)
    points = len(claim.environments) * len(claim.robots) * len(claim.variants)
    assert len(runs_of(claim, 5)) == 5 * points


def test_without_leaders_the_team_stalls_where_with_leaders_it_finishes() -> None:
    claim = BY_NAME["L1"]
    finished = {case.variant: run(case).finished for case in runs_of(claim, 1)}
    assert finished == {"leaders": True, "potential-field": False}


def test_a_table_gives_mean_interval_and_how_many_finished() -> None:
    claim = BY_NAME["L1"]
    steps = {"leaders": [40, 50, 60], "potential-field": [70, 80, 90]}
    runs = [
        Run("L1", "leader-trap", 3, variant, seed, count, variant == "leaders" or seed > 0)
        for variant, counts in steps.items()
        for seed, count in enumerate(counts)
    ]
    screen = Console(width=120)
    with screen.capture() as shown:
        screen.print(table(claim, runs))
    # Student's t for two degrees of freedom is 4.303: 4.303 * 10 / sqrt 3.
    assert "50 ± 25" in shown.get()
    assert "85 ± 64 (2 of 3)" in shown.get()
