"""Strategies by name: parts, options, refusals, and one from outside the tree."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from agent.strategies.catalog import COMBINING, catalog
from agent.strategies.registry import strategies, strategy
from agent.strategies.targets import Parts

NAMES = [
    "burgard", "burgard-optimal", "classical", "continuous-replan", "greedy", "hungarian", "hungarian-depot",
    "iterative", "leaders", "meier", "mtsp", "mtsp-depot", "nearest", "potential-field", "repairmen",
    "scan-replan", "sheng-bid", "stop-scan-replan",
]  # fmt: skip


def test_all_strategies_of_the_papers_are_there_with_a_line_and_a_source() -> None:
    entries = {entry.name: entry for entry in catalog()}
    assert set(NAMES) <= set(entries)
    for name in NAMES:
        assert entries[name].summary
        assert (
            "section" in entries[name].source or "Eq." in entries[name].source or "(" in entries[name].source
        )
        assert all(line.help for line in entries[name].options)


def test_the_text_on_combining_names_every_choice_of_every_part() -> None:
    for part in Parts.__dataclass_fields__.values():
        assert part.name in COMBINING
        assert all(choice in COMBINING for choice in part.metadata["choices"])


def test_an_unknown_strategy_is_rejected_with_a_list_of_names() -> None:
    with pytest.raises(ValueError, match=r"no strategy is called 'best'.*burgard, .*stop-scan-replan"):
        strategy("best")


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("meier", {"gamma": 1}, r"meier has no option 'gamma'; there are: candidates, .*beta"),
        ("meier", {"beta": "much"}, r"option beta of meier must be a number, not 'much'"),
        ("meier", {"half_life": -0.01}, r"option half_life of meier must be 0 or more, not -0.01"),
        ("burgard", {"every": -1}, r"option every of burgard must be 0 or more, not -1"),
        ("burgard-optimal", {"beta": -1}, r"option beta of burgard-optimal must be 0 or more"),
        ("leaders", {"first": -1}, r"option first of leaders must be 0 or more"),
        ("potential-field", {"damping": -0.1}, r"option damping of potential-field must be 0 or more"),
        ("sheng-bid", {"gain": -1.0}, r"option gain of sheng-bid must be 0 or more"),
        ("meier", {"herding": 1}, r"option herding of meier must be true or false"),
        ("hungarian", {"candidates": "all"}, r"candidates of hungarian is one of cells, rfe, anr.*not 'all'"),
        ("meier", {"candidates": "breadth-first"}, r"candidates = breadth-first: .*no goals to compare"),
        (
            "nearest",
            {"scan": "at-target"},
            r"scan = at-target, replan = at-once: .*must stay for a full turn",
        ),
        (
            "scan-replan",
            {"costs": "weighted"},
            r"breadth-first search visits cells in the order of their distance",
        ),
        ("scan-replan", {"candidates": "cells"}, r"takes the first cell that its search finds"),
        ("burgard", {"replan": "after-turn"}, r"would wait for its slowest scanner"),
        ("greedy", {"candidates": "breadth-first"}, r"one robot's goal, not a team's"),
        ("mtsp", {"candidates": "cells"}, r"a tour needs the way between every two goals"),
        ("repairmen", {"candidates": "cells"}, r"candidates of repairmen is one of edges; not 'cells'"),
        ("repairmen", {"latency_weight": -1.0}, r"option latency_weight of repairmen must be 0 or more"),
        ("hungarian-depot", {"mission": "open"}, r"include the way to the depot"),
        (
            "greedy",
            {"goals": "mean", "candidates": "cells"},
            r"each frontier cell is a goal, so there are no",
        ),
        ("mtsp", {"tours": "exact"}, r"option tours of mtsp is one of nearest-12, whole; not 'exact'"),
        ("hungarian", {"tours": "whole"}, r"hungarian has no option 'tours'"),
        ("mtsp-depot", {"mission": "open"}, r"include the way to the depot"),
        (
            "leaders",
            {"candidates": "rfe"},
            r"leaders takes no option 'candidates': forces move the robots",
        ),
        ("potential-field", {"rho_lead": 3.0}, r"potential-field has no option 'rho_lead'"),
        (
            "leaders",
            {"rho_robots": 9.0},
            r"needs 0 < rho_obstacles <= rho_robots <= rho_lead, not .*rho_robots = 9",
        ),
    ],
)
def test_conflicting_options_are_rejected_with_the_reason(
    name: str, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        strategy(name).check(options)


def test_every_number_among_the_options_has_a_bound_or_a_place_in_an_order() -> None:
    for entry in catalog():
        for line in entry.options:
            if type(line.default) in (int, float) and not line.name.startswith("rho_"):
                assert line.least == 0


@pytest.mark.parametrize(("name", "farthest"), [("leaders", "rho_lead"), ("potential-field", "rho_robots")])
def test_the_radio_range_must_cover_the_ranges_of_forces_and_leadership(name: str, farthest: str) -> None:
    kind = strategy(name)
    reach = getattr(kind.options_type(), farthest)
    kind.check_range({}, reach)
    with pytest.raises(
        ValueError, match=rf"{name} needs {farthest} <= range, not {farthest} = {reach:g} m with"
    ):
        kind.check_range({}, reach - 0.1)


@pytest.mark.parametrize("name", NAMES)
def test_the_defaults_of_every_strategy_fit_together(name: str) -> None:
    kind = strategy(name)
    assert kind.check({}) == kind.options_type()
    assert kind.returns({}) == name.endswith("-depot")


@pytest.mark.parametrize("candidates", ["cells", "rfe", "anr"])
@pytest.mark.parametrize("replan", ["at-goal", "at-once"])
@pytest.mark.parametrize("mission", ["open", "return"])
@pytest.mark.parametrize("name", ["meier", "burgard", "greedy", "hungarian", "sheng-bid"])
def test_compatible_parts_combine(name: str, candidates: str, replan: str, mission: str) -> None:
    chosen = strategy(name).check({"candidates": candidates, "replan": replan, "mission": mission})
    assert (chosen.candidates, chosen.replan, chosen.mission) == (candidates, replan, mission)


OUTSIDE = '''
import numpy as np
from agent.strategies.targets import TargetStrategy

class Farthest(TargetStrategy):
    """Drives to the farthest frontier cell."""

    name = "farthest"
    summary = "each robot drives to the frontier cell that is farthest from it"
    source = "an example"

    def choose(self, situation, goals, planner):
        costs = planner.costs(*situation.here)[goals[:, 1], goals[:, 0]]
        x, y = goals[np.argmax(costs)]
        return int(x), int(y)
'''


def test_a_strategy_from_outside_the_tree_is_one_class_and_explores(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from deploy.run.in_memory import MemoryRun
    from deploy.scenario import plan
    from deploy.scenario.scenario import parse

    (tmp_path / "my_swarm.py").write_text(OUTSIDE, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    scenario = parse(
        {"map": "leader-rooms", "strategy": "my_swarm:Farthest", "bandwidth": "unlimited", "robots": 2}
    )
    records = MemoryRun(plan.make(scenario)).complete()
    assert records.end is not None
    assert records.end.reason == "explored"
    assert records.explored > 0.99
    assert "farthest" not in strategies(), "only as my_swarm:Farthest"


def test_a_class_that_is_no_strategy_or_cannot_be_imported_is_rejected() -> None:
    with pytest.raises(ValueError, match=r"no_such_module.*PYTHONPATH"):
        strategy("no_such_module:Best")
    with pytest.raises(
        ValueError, match=r"Path is not a subclass of agent.strategies.base.Strategy with a name"
    ):
        strategy("pathlib:Path")
    with pytest.raises(ValueError, match=r"strategy 'pathlib:': must be package.module:Class"):
        strategy("pathlib:")


def test_an_incomplete_class_or_a_module_that_exits_is_rejected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    unfinished = OUTSIDE.partition("    def choose")[0].replace("Farthest", "Unfinished")
    (tmp_path / "unfinished_swarm.py").write_text(unfinished, encoding="utf-8")
    (tmp_path / "leaving_swarm.py").write_text("raise SystemExit(0)\n", encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(ValueError, match=r"Unfinished does not define the abstract methods choose"):
        strategy("unfinished_swarm:Unfinished")
    with pytest.raises(ValueError, match=r"(?s)leaving_swarm:Own' cannot be imported.*SystemExit: 0"):
        strategy("leaving_swarm:Own")
