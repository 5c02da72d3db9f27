"""The text that explains the dashboard, with the figures of the run."""

from __future__ import annotations

from deploy.scenario.plan import Plan

HELP = """\
**{robots} robots explore an unknown building.** Sensor range: {sensor} m. Radio: {medium}.

**Left: the {truth} map.** A line leads from each robot to its target. {circles}Dark arrows: bytes received in this \
step, from the sender to each receiver. Pale lines: robots in range.{chosen}

**Right: each robot's map.** White: free, black: wall, gray: unknown. {outlines}

**Below: the radio.** {budget}Bytes per step, in total (thick) and by type. Explored: area seen by the team (thick), \
and area on each robot's map; the gap is map data not yet received. Walls: within one cell of the true ones, F1 \
(thick) and precision (thin) of each robot's map. Axes below count steps, which Rerun marks with #.
"""
OUTLINES = "Pale outlines: received from teammates."


def _sensor_ranges(plan: Plan) -> str:
    ranges = [body.range_cells * plan.map.resolution for body in plan.world.bodies]
    least, most = min(ranges), max(ranges)
    return f"{most:g}" if least == most else f"{least:g} to {most:g}"


def explain(plan: Plan) -> str:
    """Explain the dashboard, in markdown, with the figures of this run."""
    budget = plan.radio.budget
    polygons = plan.scenario.map_encoding == "polygons"
    medium = "unlimited bandwidth" if budget.unlimited else f"{budget} bytes per step (one second)"
    if plan.has_truth:
        medium += f", range {plan.range_m:.0f} m"
    return HELP.format(
        robots=plan.scenario.robots,
        sensor=_sensor_ranges(plan),
        medium=medium,
        chosen=" The tab *True map* beside it shows one robot at a time." if plan.scenario.robots > 1 else "",
        circles="Circles: radio range. " if shows_range(plan) else "",
        outlines=OUTLINES if polygons else "It includes map data received from teammates.",
        budget="" if budget.unlimited else "Thin gray line: the limit. ",
        truth="true" if plan.has_truth else "team's final",
    )


def shows_range(plan: Plan) -> bool:
    """Whether to draw the radio range: not if it is unknown, or covers most of the map."""
    return plan.has_truth and plan.range_m < plan.map.diagonal_m / 2
