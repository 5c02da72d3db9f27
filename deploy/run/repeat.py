"""Whether a finished run can be repeated from its directory."""

from __future__ import annotations

from typing import Any

CUT_SHORT = ("interrupted", "broken off")
"""End reasons of runs that were cut short."""


def why_unrepeatable(summary: dict[str, Any]) -> str:
    """Return why a run cannot be repeated: an event that its scenario does not contain; empty if it can."""
    if summary["reason"] in CUT_SHORT:
        return f"it was {summary['reason']} at step {summary['steps']}"
    back = "; ".join(
        f"robot {robot} was lost at step {step} and came back" for step, robot in summary.get("returned", [])
    )
    if back:
        return f"{back}, unexpectedly"
    lost = "; ".join(f"robot {robot} was lost: {cause}" for robot, cause in summary["lost"].items())
    return f"{lost}, unexpectedly" if lost else ""
