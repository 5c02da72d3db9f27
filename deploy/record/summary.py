"""The summary of a run: its metrics (`deploy.record.columns.SUMMARY`) and its digest, equal for equal runs."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from agent.completion import sure_after
from deploy.record import map_quality, missed_phases
from deploy.record.ledger_figures import budgets, duty_cycle, over_budget, per_kind, undelivered
from deploy.record.map_code import map_code_figures
from deploy.record.map_quality import Figures
from deploy.record.number_texts import counted
from deploy.record.records import Records
from deploy.record.team_effort import longest_path_m, overlaps, report_at
from deploy.record.versions import versions
from deploy.scenario.plan import Plan
from netshaper.airtime import HOUR_S
from netshaper.ledger import sort_rows
from protocol.grid import FREE, OCCUPIED, Grid, Mask
from protocol.messages import End
from worldsim.recorded.world import Stretch

TOO_EARLY = "stopped too early"
"""End of the reason of a run whose first robot to finish had seen too little."""

POLYGONS = "polygons"
"""The map encoding that approximates maps."""

SCAN_VALUES, VALUE_BYTES = 362, 2
"""Size of a raw scan by the thesis' formula (section 6.3): 360 ranges and a position, sent to each teammate."""


def replayed(summary: dict[str, Any]) -> str:
    """Return how much of a log a recorded run has replayed, and whether teammates hold all maps."""
    first = f"Replayed {counted(summary['scans'], 'scan')} in {counted(summary['steps'], 'step')}"
    late = summary["steps_after_scans"]
    if summary["finished"]:
        when = f"{counted(late, 'step')} after the last scan" if late else "in the step of the last scan"
        return f"{first}; teammates held all maps {when}. {summary['bytes_per_scan']} B per scan."
    missing = f"teammates lack {summary['backlog']} log entries"
    return f"{first}, not finished: {summary['reason']}; {missing}."


def summarize(plan: Plan, records: Records, wall_s: float) -> dict[str, Any]:
    """Compute ``summary.json`` from the records; metrics that an aborted run does not have are null."""
    scenario = plan.scenario
    end = records.end
    done = end is not None and end.first >= 0
    finished = done and records.explored >= scenario.min_coverage
    ledger = records.ledger()
    reachable = plan.reachable
    refuted = _refuted_maps(plan, records, reachable)
    planning = {robot: grid for robot, grid in sorted(records.planning.items()) if robot not in refuted}
    claimed = {robot: float((grid[reachable] == FREE).mean()) for robot, grid in planning.items()}
    accuracy = {robot: min(share, records.explored) for robot, share in claimed.items()}
    walls = _robot_figures(plan, records, planning, reachable)
    figures: dict[int, Figures] = {
        robot: {"map_accuracy": accuracy[robot], **each} for robot, each in walls.items()
    }
    first = end.first if done and end is not None else min(records.planning, default=-1)
    steps = end.step if end is not None and end.step >= 0 else records.step
    allowed = budgets(plan.radio.budget, records.changes, int(ledger["step"].max(initial=0)) + 1)
    common = common_figures(plan, records, figures, first)
    return {
        "finished": finished,
        "reason": _reason(end, finished=finished),
        "steps": steps,
        "explored_at": _explored_at(plan, steps) if finished else None,
        "known_at": _known_at(plan, records, steps, finished=finished),
        "first_robot": end.first if done and end is not None else None,
        "coverage": records.explored,
        **map_quality.first_mean_worst("", "map_accuracy", accuracy, first),
        **map_quality.first_mean_worst("claimed_", "map_accuracy", claimed, first),
        **_progress(records),
        **_overlaps(records, reachable, refuted),
        "refuted_maps": refuted,
        **common,
        "bus": scenario.bus,
        "range_m": plan.range_m,
        "finish": "all" if plan.world.ends_with_all else "first",
        **missed_phases.figures(records.missed, scenario.robots),
        "raw_scan_bytes": raw_scan_bytes(steps, scenario.robots),
        **_recorded_figures(plan, records, steps, common["bytes"]["total"]),
        **_approximation_error(records, first, int(reachable.sum()), scenario.map_encoding),
        "over_budget_steps": over_budget(ledger, allowed, plan.radio.saving, each=scenario.radio.reuse),
        "duty_cycle": duty_cycle(ledger, allowed, HOUR_S * plan.radio.saving.steps),
        "wall_s": round(wall_s, 3),
        "steps_per_s": round(records.step / wall_s, 1) if wall_s else None,
        "versions": versions(),
    }


def common_figures(plan: Plan, records: Records, figures: dict[int, Figures], first: int) -> dict[str, Any]:
    """Return the keys of the summary that robots in the field have as well: they need neither true map nor relay.

    `figures` are those of each robot's map; `first` is the number of the first robot, -1 if there is none.
    """
    scenario, ledger = plan.scenario, records.ledger()
    sizes = per_kind(ledger, "bytes")
    last = records.world[-1] if records.world else None
    return {
        **map_quality.team_figures(figures, first),
        "robot_maps": {str(robot): each for robot, each in figures.items()},
        "longest_path": longest_path_m(last),
        "path_length": [mm / 1000 for mm in last.driven] if last is not None else [],
        "robots": scenario.robots,
        "seed": scenario.seed,
        "map": plan.map.name,
        "strategy": scenario.strategy,
        "map_encoding": scenario.map_encoding,
        "bandwidth": scenario.bandwidth,
        "clock": scenario.clock,
        "step_s": scenario.step_s,
        "tolerance": tolerance(plan),
        "bytes": sizes,
        **map_code_figures(records.planning.get(first), sizes["total"]),
        "packets": per_kind(ledger, "packets"),
        "undelivered": undelivered(ledger),
        "lost": {str(robot): cause for robot, cause in sorted(records.lost.items())},
        "returned": [list(each) for each in records.returned],
        "reconnected": [list(each) for each in records.reconnected],
        "protocol_errors": records.protocol_errors.counts.total(),
        "digest": digest(records),
        "work_us_median": median_work(records),
    }


def raw_scan_bytes(steps: int, robots: int) -> int:
    """Return the bytes of raw scans that each robot sends to each other one in so many steps, by section 6.3."""
    return steps * SCAN_VALUES * VALUE_BYTES * robots * (robots - 1)


def _reason(end: End | None, *, finished: bool) -> str:
    """Why the run ended: a robot reports the end of its exploration, and the records show its true coverage."""
    if end is None:
        return "broken off"
    return end.reason if finished or end.first < 0 else f"robot {end.first} {TOO_EARLY}"


def digest(records: Records, without: Collection[int] = ()) -> str:
    """Hash canonical integers by SHA-256: the sorted ledger, poses by step and robot, all grids.

    Poses are in whole millimeters and tenths of a degree. Each number is a little-endian int64, but those of people are
    int32; grids are uint8, preceded by their robot and shape. Grids of robots in `without` do not count.
    """
    total = hashlib.sha256()
    rows = sort_rows(records.ledger())
    for name in rows.dtype.names or ():
        total.update(np.ascontiguousarray(rows[name]).astype("<i8").tobytes())
    for report in records.world:
        poses = report.pose_rows.astype("<i8")
        total.update(np.array([report.step], "<i8").tobytes() + poses.tobytes() + report.people)
    for grids in (records.own, records.planning):
        for robot, grid in sorted(grids.items()):
            if robot in without:
                continue
            total.update(np.array([robot, *grid.shape], "<i8").tobytes() + grid.tobytes())
    return total.hexdigest()


def _refuted_maps(plan: Plan, records: Records, reachable: Mask) -> list[int]:
    """Return the robots that sent an own map that is false (`deploy.record.map_quality.is_refuted`)."""
    seen = records.world[-1].seen if records.world else 0
    noisy = plan.robot_settings[0].laser is not None
    return [
        robot
        for robot, own in sorted(records.own.items())
        if map_quality.is_refuted(own, plan.map.cells, reachable, seen, noisy=noisy)
    ]


def tolerance(plan: Plan) -> int:
    """Return the distance in cells within which walls of different robots' maps should agree.

    It is the tolerance of shared maps, and at least 1 if lasers or poses have errors.
    """
    return max(plan.scenario.tolerance, int(plan.scenario.is_noisy))


def _robot_figures(
    plan: Plan, records: Records, planning: dict[int, Grid], reachable: Mask
) -> dict[int, Figures]:
    """Compare walls of the `planning` grids with true walls, and those of shared grids with teammates' settled ones."""
    shared = {robot: records.shared[robot] for robot in planning}
    walls = {robot: records.settled[robot] & (records.own[robot] == OCCUPIED) for robot in sorted(planning)}
    true_walls = map_quality.true_walls_of(plan, reachable)
    return map_quality.robot_figures(planning, shared, walls, true_walls, tolerance(plan))


def _progress(records: Records) -> dict[str, float | None]:
    """Return when the team had seen shares of the area, and the longest paths of a robot until then."""
    found = {f"t{percent}": report_at(records.world, percent / 100) for percent in (50, 90, 95, 99)}
    return {
        **{key: None if report is None else report.step for key, report in found.items()},
        "longest_path_95": longest_path_m(found["t95"]),
        "longest_path_99": longest_path_m(found["t99"]),
    }


def _overlaps(records: Records, reachable: Mask, refuted: Collection[int]) -> dict[str, float | None]:
    """Return how much several robots have seen; None for all if a grid is missing or false."""
    if refuted or not records.own or not records.has_all_grids:
        return dict.fromkeys(("overlap", "overlap_sum", "seen_std"))
    return {**overlaps(records.own.values(), reachable)}


def _recorded_figures(plan: Plan, records: Records, steps: int, transmitted: int) -> dict[str, Any]:
    """Return the keys that only the summary of a recorded run has (`deploy.record.columns.RECORDED`).

    `transmitted` are the bytes that the team sent in all `steps`.
    """
    recording = plan.recording
    if recording is None:
        return {}
    with_scans = plan.scenario.robots - plan.scenario.recording.listeners
    scans = _replayed(recording.stretches[:with_scans], records)
    last_scan = max(int(each.steps[-1]) for each in recording.stretches)
    end = records.end
    finished = end is not None and end.first >= 0
    delivered = steps - sure_after(plan.robot_settings[0]) - 1 if finished else steps
    return {
        "logs": list(plan.scenario.recording.files),
        "scans": scans,
        "bytes_per_scan": round(transmitted / scans, 2) if scans else None,
        "steps_after_scans": max(0, delivered - last_scan),
        "backlog_after_scans": _backlog(records, last_scan),
        "backlog": _backlog(records, steps),
    }


def _replayed(stretches: Sequence[Stretch], records: Records) -> int:
    """Count the scans that the first robots, those with scans, took before they ended."""
    return sum(
        int(np.isin(stretch.steps, [status.step for status in statuses]).sum())
        for stretch, statuses in zip(stretches, records.statuses, strict=False)
    )


def _backlog(records: Records, step: int) -> int:
    """Return the log entries that teammates lack at the end of a step, summed over all pairs of robots."""
    return sum(status.backlog for statuses in records.statuses for status in statuses if status.step == step)


def _approximation_error(
    records: Records, robot: int, cells: int, map_encoding: str
) -> dict[str, float | None]:
    """Mean of a robot's approximation error d(t) over the steps, as a share of all cells (thesis, Eq. 6.1).

    The net error is the same minus the error of an exact approximation; None if that was not measured. Both are None if
    the map encoding does not approximate.
    """
    reports = records.statuses[robot] if 0 <= robot < len(records.statuses) else []
    error, exact = (
        np.array([(report.error, report.exact_error) for report in reports]).reshape(-1, 2).T / cells
    )
    if not len(error) or not (map_encoding == POLYGONS or error.any()):
        return dict.fromkeys(("approximation_error", "approximation_error_net"))
    net = float((error - exact).mean()) if exact.min() >= 0 else None
    return {"approximation_error": float(error.mean()), "approximation_error_net": net}


def _explored_at(plan: Plan, steps: int) -> int:
    """The step after which the first robot only verified that it had finished."""
    return steps - sure_after(plan.robot_settings[0])


def _known_at(plan: Plan, records: Records, steps: int, *, finished: bool) -> int | None:
    """The step at which the first robot knew the full map, at the latest when it had nothing left to explore."""
    if records.known_at is None or (not records.known_at and not finished):
        return None
    return records.known_at or _explored_at(plan, steps)


def median_work(records: Records) -> float | None:
    """Median computing time of a robot per step, in microseconds."""
    work = [report.work_us for reports in records.statuses for report in reports]
    return float(np.median(work)) if work else None
