"""The text that explains the dashboard."""

from __future__ import annotations

from deploy.scenario.plan import Plan

TEXT = """\
**{robots} robots explore an unknown building.** Sensor range: {sensor:g} m. Radio: {medium}.

**Left: the true map.** A line leads to each target. {circles}Links: green ones carry data, grey ones could.{chosen}

**Right: what each robot knows.** Floor is white, wall black, grey unknown. {outlines}

**Below: the radio.** {budget}Bytes a step, and what for. Thick line: what the team has seen; in colours: what \
each robot has on its map. The gap is news still under way.
"""
OUTLINES = "Faint outlines were received."


def map_id(plan: Plan) -> str:
    """Explain the dashboard, in markdown, with the figures of this run."""
    budget = plan.radio.budget
    polygons = plan.scenario.map_encoding == "polygons"
    medium = "unlimited bandwidth" if budget.unlimited else f"{budget} bytes a step (a second)"
    medium += f", range {plan.range_m:.0f} m"
    return TEXT.format(
        robots=plan.scenario.robots,
        sensor=plan.scenario.sensor_range,
        medium=medium,
        chosen=" Tabs show one robot each." if plan.scenario.robots > 1 else "",
        circles="Circles: radio range. " if shows_range(plan) else "",
        outlines=OUTLINES if polygons else "What it has not seen itself it was told.",
        budget="" if budget.unlimited else "Red: the limit. ",
    )


def shows_range(plan: Plan) -> bool:
    """Whether the radio's range is worth drawing: not if robots hear each other nearly everywhere."""
    return plan.range_m < plan.map.diagonal_m / 2
