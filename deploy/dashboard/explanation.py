"""The words that tell a newcomer what the dashboard shows."""

from __future__ import annotations

from deploy.scenario.plan import Plan
from netshaper.medium import UNLIMITED

TEXT = """\
**{robots} robots explore a building that none of them knows.** Each sees {sensor:g} m far. By radio they tell \
what they find: {medium}. They are done when one has nothing left to explore.

**Left, the truth.** Discs are robots, a line leads from each to its target. {circles}Grey and green lines \
join who can hear each other; on green ones they talk.

**Right, what each robot knows.** White is floor, black is wall, grey is unknown. {outlines}

**Below, the radio.** {budget}What the team has seen is white, what each robot's map holds has its colour; \
between them lies news not told yet.
"""
OUTLINES = "Thick outlines are what it tells of its map, thin ones are what others told it."


def about(plan: Plan) -> str:
    """Explain what is seen, in markdown, with the figures of this run."""
    budget = plan.radio.budget
    polygons = plan.scenario.exchange == "polygon"
    medium = "as much as they like" if budget == UNLIMITED else f"at most {budget} bytes a step (one second)"
    medium += f", {plan.range_m:.0f} m far"
    return TEXT.format(
        robots=plan.scenario.robots,
        sensor=plan.scenario.sensor_range,
        medium=medium,
        circles="Circles show how far each is heard. " if shows_range(plan) else "",
        outlines=OUTLINES if polygons else "What it has not seen itself, others have told it.",
        budget="" if budget == UNLIMITED else "The red line is the limit. ",
    )


def shows_range(plan: Plan) -> bool:
    """Whether the radio's range is worth drawing: not if robots hear each other nearly everywhere."""
    return plan.range_m < plan.map.diagonal_m / 2
