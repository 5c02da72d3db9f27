"""Figures of recorded runs, which other runs do not have (`deploy.record.columns.RECORDED`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from agent.completion import sure_after
from deploy.record.records import Records
from deploy.scenario.plan import Plan
from worldsim.recorded.world import Stretch


def recorded_figures(plan: Plan, records: Records, steps: int, transmitted: int) -> dict[str, Any]:
    """Return the keys that the summary of a recorded run has; none for other runs.

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
