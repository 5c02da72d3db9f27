"""Repeating a finished run: whether that is possible, and the robots' maps over time."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from agent.robot import Robot
from deploy.dashboard.process import ViewNode
from deploy.record.snapshots import Snapshots
from deploy.record.summary import digest
from deploy.run import in_memory
from deploy.scenario.plan import Plan

CUT_SHORT = ("interrupted", "broken off")
"""End reasons of runs that were cut short."""


def why_unrepeatable(summary: dict[str, Any]) -> str:
    """Why a run cannot be repeated: an event that its scenario does not contain; an empty text if it can."""
    if summary["reason"] in CUT_SHORT:
        return f"it was {summary['reason']} at step {summary['steps']}"
    back = "; ".join(
        f"robot {robot} was lost at step {step} and came back" for step, robot in summary.get("returned", [])
    )
    if back:
        return f"{back}, unasked"
    lost = "; ".join(f"robot {robot} was lost: {cause}" for robot, cause in summary["lost"].items())
    return f"{lost}, unasked" if lost else ""


def robots_at(plan: Plan, step: int) -> list[Robot]:
    """Repeat a run in memory up to a step; the robots, with all that they hold then."""
    found: list[Robot] = []
    cut = replace(plan, scenario=plan.scenario.model_copy(update={"steps": step}))
    in_memory.run(cut, leave=found.extend)
    return found


def maps_over_time(plan: Plan, expected: str) -> Snapshots | None:
    """Repeat a run in memory and keep the robots' maps; None if its digest is not the `expected` one."""
    snapshots = Snapshots()
    records = in_memory.run(plan, view=ViewNode([snapshots]))
    return snapshots if digest(records) == expected else None
