"""The identity of a map: the robot that writes it, and which of that robot's incarnations.

A robot that restarts after losing its state starts a new log (`agent.identity`). Packets name a log by one number:
robot plus `robots` times incarnation. This module is the only place that converts between the two.
"""

from __future__ import annotations

from typing import NamedTuple


class MapId(NamedTuple):
    """One robot's map in one of its incarnations."""

    robot: int
    """The robot that writes the map."""
    incarnation: int
    """How often that robot had restarted when it began the map."""
    number: int
    """The number of the map in packets, and its row or column in tables."""


def map_ids(robots: int, incarnations: int = 1) -> list[MapId]:
    """Return all maps that a team may write, ascending by number."""
    return [MapId(number % robots, number // robots, number) for number in range(robots * incarnations)]
