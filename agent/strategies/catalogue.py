"""What people are told of strategies: `murmur strategies` prints it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from agent.strategies import strategies
from agent.strategies.options import OptionLine, option_lines

COMBINING = """\
A strategy is made of parts. Each names its own; options exchange them:
  candidates  cells, rfe, anr, breadth-first   which cells are worth going to
  costs       shortest, weighted               length of ways, or length times occupancy of the smoothed map
  replan      at-goal, at-once, after-turn     at the target; when it is no frontier any more; after a full turn
  mission     open, return                     the run ends with the first that is done, or when all are home
  scan        always, at-target                whether scanners work on the way
  share       always, at-target                whether news waits until a target is reached or replaced
What does not combine, and is refused with the reason: breadth-first with weighted costs, with strategies that
weigh several goals, or with teams; after-turn with teams; scan = at-target without after-turn; mtsp on all
cells; the depot strategies on open missions; any of these parts with the potential field."""


@dataclass(frozen=True)
class Entry:
    """One strategy.

    Attributes
    ----------
    name, summary, source : str
    options : list of OptionLine
        With their defaults.
    refused : mapping of option to reason
        Options of others that it cannot have.
    """

    name: str
    summary: str
    source: str
    options: list[OptionLine]
    refused: Mapping[str, str]


def catalogue() -> list[Entry]:
    """All strategies that have been imported, by name."""
    return [
        Entry(name, kind.summary, kind.source, option_lines(kind.options_type), kind.refused)
        for name, kind in strategies().items()
    ]
