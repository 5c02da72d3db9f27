"""The words that tell a newcomer what the dashboard shows."""

from __future__ import annotations

from deploy.plan import Plan
from netshaper.medium import UNLIMITED

TEXT = """\
**{robots} robots explore a building that none of them knows.** Each sees {sensor:g} m far with its laser. \
By radio they tell each other what they have found: {medium}, and over {reach:.0f} m at most. They are done \
when one of them has nothing left to explore on its map.

**On the left, the truth.** Discs are robots; a line leads from each to where it is heading. {circles}Robots \
that are joined by a line can hear each other; where the line is green, they talk just now.

**On the right, what each robot knows.** White is floor, black is wall, grey is unknown yet. {outlines}

**Below, the radio.** {budget}A white line says how much the team has seen, coloured ones how much of it \
each robot has on its map. What lies between is news that has not been told.
"""
OUTLINES = (
    "Thick outlines are what it tells of its own map, thin ones in others' colours are what it was told."
)


def about(plan: Plan) -> str:
    """Explain what is seen, in markdown, with the figures of this run."""
    budget = plan.radio.budget
    polygons = plan.scenario.exchange == "polygon"
    return TEXT.format(
        robots=plan.scenario.robots,
        sensor=plan.scenario.sensor_range,
        reach=plan.range_m,
        medium="as much as they like"
        if budget == UNLIMITED
        else f"at most {budget} bytes a step (one second), all together",
        circles="Thin circles show how far each is heard. " if shows_range(plan) else "",
        outlines=OUTLINES if polygons else "What it has not seen itself it was told.",
        budget="" if budget == UNLIMITED else "No more than the red line fits into a step. ",
    )


def shows_range(plan: Plan) -> bool:
    """Whether the radio's range is worth drawing: not if robots hear each other nearly everywhere."""
    return plan.range_m < plan.map.diagonal_m / 2
