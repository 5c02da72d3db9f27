"""Errors of poses move walls of teammates' maps: they do not enclose a robot, which would report the end of the run."""

from __future__ import annotations

from typing import Any

import numpy as np
from msgspec.structs import replace

from protocol.cell_bytes import cells_from_bytes
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.messages import Sense
from protocol.own_map import OwnMapPart, encode_own_map
from tests.system.team import Member, Team, plan_on
from worldsim.maps import Map

HEIGHT, WIDTH = 16, 48
CELLS = {0: (8, 5), 1: (4, 5)}
"""Where the robots stand, on both sides of a wall."""

SETTINGS: dict[str, Any] = {
    "robots": 2, "laser": {"preset": "utm-30lx"}, "bandwidth": 25, "map_encoding": "predictive",
    "dissemination": "gossip",
}  # fmt: skip


def own_maps(first_free: int) -> dict[int, Grid]:
    """Return the maps of both robots; they have the same wall in columns 7 and 8, because their poses have errors.

    Robot 0 sees cells up to column 29, free ones from `first_free` on, and cannot look behind them.
    """
    maps = {robot: np.full((HEIGHT, WIDTH), UNKNOWN, np.uint8) for robot in CELLS}
    maps[0][:, 7:first_free] = OCCUPIED
    maps[0][:, first_free:30] = FREE
    maps[1][:, 0:8], maps[1][:, 8] = FREE, OCCUPIED
    return maps


def play(maps: dict[int, Grid], steps: int) -> Team:
    """Let robots with these maps, which their own SLAM makes, stand there and exchange them."""
    truth = np.full((HEIGHT, WIDTH), FREE, np.uint8)
    truth[:, 7] = OCCUPIED
    plan = plan_on(Map("wall", truth, 0.1), **SETTINGS)
    members = {robot: Member(replace(each, has_own_map=True)) for robot, each in plan.robot_settings.items()}
    team = Team(plan, members)
    for step in range(1, steps + 1):
        parts = {
            robot: encode_own_map(OwnMapPart((0, 0, WIDTH, HEIGHT), each)) for robot, each in maps.items()
        }
        team.play(
            {
                robot: Sense(step, x, y, 0, b"", b"", "", own_map=parts[robot])
                for robot, (x, y) in CELLS.items()
            },
            CELLS,
        )
    return team


def test_a_copy_of_a_wall_does_not_enclose_a_robot_that_sees_free_cells_there() -> None:
    team = play(own_maps(first_free=8), 30)
    robot, move = team.robots[0], team.moves[0]
    assert (robot.planning[:, 8:10] == OCCUPIED).all(), "the copy has half resolution"
    assert not move.explored
    assert robot.target == (29, 5)
    assert cells_from_bytes(move.path)[0].tolist() == [9, 5]


def test_a_robot_that_sees_the_wall_itself_reports_that_nothing_is_left() -> None:
    team = play(own_maps(first_free=10), 30)
    assert team.moves[0].explored
    assert team.robots[0].target is None
