"""The summary of robots in the field: the keys of `deploy.record.summary`, null where they need a true map."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean
from typing import Any

import numpy as np

from deploy.after.field_run import FieldStart
from deploy.record.map_quality import WALL_FIGURES, Figures, TrueWalls, robot_figures
from deploy.record.records import Records
from deploy.record.summary import common_figures, tolerance
from deploy.record.versions import versions
from deploy.scenario.plan import Plan
from protocol.grid import FREE, OCCUPIED
from protocol.messages import End

NEEDS_TRUTH = (
    "explored_at", "known_at", "coverage", "map_accuracy", "mean_map_accuracy", "worst_map_accuracy",
    "claimed_map_accuracy", "claimed_mean_map_accuracy", "claimed_worst_map_accuracy", "t50", "t90", "t95", "t99",
    "longest_path_95", "longest_path_99", "overlap", "overlap_sum", "seen_std", "range_m", "raw_scan_bytes",
    "approximation_error", "approximation_error_net", "over_budget_steps", "duty_cycle",
)  # fmt: skip
"""Keys that are null: they need a true map, the distances of a relay, or a budget per step."""


def summarize_field(plan: Plan, records: Records, starts: Sequence[FieldStart]) -> dict[str, Any]:
    """Compute ``summary.json`` of robots in the field; `records` then has their end."""
    scenario = plan.scenario
    last = {each.robot: each.record.ending for each in starts}
    ends = {robot: ending for robot, ending in last.items() if ending is not None}
    finished = len(ends) == scenario.robots and all(each.is_complete for each in ends.values())
    whole = [robot for robot, ending in sorted(ends.items()) if ending.is_complete]
    first = min(whole, key=lambda robot: len(records.statuses[robot]), default=-1)
    reason = "explored" if finished else _reason(plan, ends)
    records.end = End(records.step, reason, first)
    late = [0] * scenario.robots
    for each in starts:
        if each.record.steps:
            late[each.robot] += each.record.steps[-1].late_steps
    figures = _figures(plan, records)
    held = [share for each in figures.values() if (share := each["team_map_held"]) is not None]
    return {
        "finished": finished,
        "reason": reason,
        "steps": records.step,
        "first_robot": first if first >= 0 else None,
        **dict.fromkeys(NEEDS_TRUTH),
        **common_figures(plan, records, figures, first),
        "team_map_held": fmean(held) if held else None,
        "worst_team_map_held": min(held, default=None),
        "refuted_maps": [],
        "bus": "field",
        "finish": "all",
        "missed_steps": sum(late),
        "missed_steps_by_robot": late,
        "missed_phases": 0,
        "wall_s": round(records.step * scenario.step_s, 3),
        "steps_per_s": round(1 / scenario.step_s, 1),
        "versions": starts[0].record.setup.versions or versions(),
    }


def _reason(plan: Plan, ends: dict[int, Any]) -> str:
    """Return why each robot ended that did not finish."""
    causes = [
        f"robot {robot}: {ends[robot].reason if robot in ends else 'no end was recorded'}"
        for robot in range(plan.scenario.robots)
        if robot not in ends or not ends[robot].is_complete
    ]
    return "; ".join(causes)


def _figures(plan: Plan, records: Records) -> dict[int, Figures]:
    """Compare the robots' maps with each other, and with the team's map."""
    nothing = np.zeros(plan.reachable.shape, np.bool_)
    whole = {robot: grid for robot, grid in sorted(records.planning.items()) if robot in records.shared}
    walls = {robot: records.settled[robot] & (records.own[robot] == OCCUPIED) for robot in whole}
    figures = robot_figures(whole, records.shared, walls, TrueWalls(nothing, nothing), tolerance(plan))
    for robot, grid in sorted(records.planning.items()):
        of_robot = figures.setdefault(robot, dict.fromkeys(WALL_FIGURES))
        of_robot["team_map_held"] = float((grid[plan.reachable] == FREE).mean())
    return dict(sorted(figures.items()))
