"""The text that explains the dashboard."""

from __future__ import annotations

from deploy.scenario.plan import Plan
from netshaper.medium import UNLIMITED

TEXT = """\
**{robots} robots explore an unknown building.** Their sensor range is {sensor:g} m. They share what they find \
by radio: {medium}. The run ends when one has nothing left to explore.

**Left: the true map.** Discs are robots, a line leads from each to its target. {circles}Green links carry data \
in this step, grey ones could.{chosen}

**Right: what each robot knows.** White is floor, black is wall, grey is unknown. {outlines}

**Below: the radio.** {budget}The thick line is what the team has seen, each robot's colour what is on its \
map; the gap between them is news that has not arrived.
"""
OUTLINES = "Strong outlines are its own, faint ones were received."


def about(plan: Plan) -> str:
    """Explain the dashboard, in markdown, with the figures of this run."""
    budget = plan.radio.budget
    polygons = plan.scenario.exchange == "polygon"
    medium = "unlimited bandwidth" if budget == UNLIMITED else f"at most {budget} bytes a step (one second)"
    medium += f", range {plan.range_m:.0f} m"
    return TEXT.format(
        robots=plan.scenario.robots,
        sensor=plan.scenario.sensor_range,
        medium=medium,
        chosen=" A tab for each robot dims the others." if plan.scenario.robots > 1 else "",
        circles="Circles: the radio range. " if shows_range(plan) else "",
        outlines=OUTLINES if polygons else "What it has not seen itself was received from others.",
        budget="" if budget == UNLIMITED else "The red line is the limit. ",
    )


def shows_range(plan: Plan) -> bool:
    """Whether the radio's range is worth drawing: not if robots hear each other nearly everywhere."""
    return plan.range_m < plan.map.diagonal_m / 2
