"""The matrix of strategies and environments: what is run, and what counts as finished."""

from __future__ import annotations

from pathlib import Path

import pytest
from rich.console import Console

from agent.strategies.registry import strategies
from deploy.scenario.scenario import parse
from deploy.study.finish import PAPERS, ROBOTS, Outcome, cases, run, table
from worldsim import generators, maps
from worldsim.process import EXPLORED, OUT_OF_STEPS, STALLED

SHIPPED = sorted(name for name, kind in strategies().items() if kind.__module__.startswith("agent."))


def test_every_strategy_of_ours_stands_in_the_matrix_and_can_be_run() -> None:
    assert sorted({name for paper in PAPERS for name in paper.strategies}) == SHIPPED
    for case in cases(SHIPPED, 1):
        parse(case.body | {"strategy": case.strategy, "robots": case.robots})
        assert case.environment in generators.names()


def test_each_strategy_has_all_robots_and_seeds_once() -> None:
    chosen = cases(["meier", "mtsp"], 5)
    assert len(chosen) == (3 + 4) * len(ROBOTS) * 5
    assert len({case.key for case in chosen}) == len(chosen)


def test_the_map_of_a_file_is_explored_once_by_every_strategy(tmp_path: Path) -> None:
    file = tmp_path / "rooms.yaml"
    maps.save(generators.make("leader-rooms"), file)
    on_it = cases(SHIPPED, 0, [str(file)])
    assert sorted(case.strategy for case in on_it) == SHIPPED
    (nearest,) = (case for case in on_it if case.strategy == "nearest")
    assert run(nearest).finished


@pytest.mark.parametrize(
    ("strategy", "coverage", "reason", "finished", "holds"),
    [
        ("meier", 1.0, EXPLORED, True, True),
        ("meier", 0.98, EXPLORED, False, False),
        ("meier", 1.0, OUT_OF_STEPS, False, False),
        ("leaders", 0.5, STALLED, False, False),
        ("potential-field", 0.5, STALLED, False, True),
        ("potential-field", 0.98, EXPLORED, False, False),
    ],
)
def test_only_the_potential_field_may_stall_and_nobody_may_leave_anything_out(
    strategy: str, coverage: float, reason: str, *, finished: bool, holds: bool
) -> None:
    outcome = Outcome(strategy, "office", 3, 0, 100, coverage, reason)
    assert (outcome.finished, outcome.holds) == (finished, holds)


def test_the_table_has_a_row_a_strategy_and_environment() -> None:
    outcomes = [
        Outcome("potential-field", "leader-trap", 3, seed, 100 + seed, 1.0 - seed / 2, reason)
        for seed, reason in enumerate((EXPLORED, STALLED))
    ]
    screen = Console(width=140)
    with screen.capture() as shown:
        screen.print(table(outcomes))
    (row,) = (line for line in shown.get().splitlines() if "potential-field" in line)
    assert "1 of 2, 1 stalled" in row
    assert "│ 100 " in row
    assert "0.5000" in row
