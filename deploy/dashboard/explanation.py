"""The text that explains the dashboard."""

from __future__ import annotations

from deploy.scenario.plan import Plan

TEXT = """\
**{robots} robots explore an unknown building.** Sensor range: {sensor:g} m. Radio: {medium}.

**Left: the true map.** A line leads to each target. {circles}Links: green with traffic, gray in range.{chosen}

**Right: each robot's map.** White: free, black: wall, gray: unknown. {outlines}

**Below: the radio.** {budget}Bytes per step, by type. Thick line: area seen by the team; colored lines: area on \
each robot's map. The gap is map data not yet received.
"""
OUTLINES = "Pale outlines: received from teammates."


def explain(plan: Plan) -> str:
    """Explain the dashboard, in markdown, with the figures of this run."""
    budget = plan.radio.budget
    polygons = plan.scenario.map_encoding == "polygons"
    medium = "unlimited bandwidth" if budget.unlimited else f"{budget} bytes per step (one second)"
    medium += f", range {plan.range_m:.0f} m"
    return TEXT.format(
        robots=plan.scenario.robots,
        sensor=plan.scenario.sensor_range,
        medium=medium,
        chosen=" Tabs show one robot each." if plan.scenario.robots > 1 else "",
        circles="Circles: radio range. " if shows_range(plan) else "",
        outlines=OUTLINES if polygons else "It includes map data received from teammates.",
        budget="" if budget.unlimited else "Red: the limit. ",
    )


def shows_range(plan: Plan) -> bool:
    """Whether to draw the radio range: not if it covers most of the map."""
    return plan.range_m < plan.map.diagonal_m / 2
