"""The settings of a robot's control logic and of its radio, derived from its settings file and its laser."""

from __future__ import annotations

import time

from msgspec.structs import replace

from agent.pose_guard import JUMP_M, PoseGuard
from agent.replication.policies import GOSSIP
from agent.settings import MediumSettings, ReplicationSettings, Settings
from deploy.field.robot_file import RobotSettings
from deploy.record.code_digest import code_digest
from deploy.record.field_records import RobotSetup, clock_id
from protocol.body import Body
from protocol.budget import Budget
from protocol.map_frame import MapFrame
from protocol.nanoseconds import SECOND
from protocol.range_scans import TURN, Laser

BEAMS = 360
"""Beams per full turn, which only exact lasers use."""


def map_frame(settings: RobotSettings) -> MapFrame:
    """Return where the team's grid lies in the common frame."""
    grid = settings.grid
    return MapFrame(grid.columns, grid.rows, grid.resolution, grid.x, grid.y)


def agent_settings(settings: RobotSettings, laser: Laser) -> Settings:
    """Return the settings of the control logic.

    Teammates count as robots with the same hardware, except for what the file says of them; all of this only affects
    plans.
    """
    cell = settings.grid.resolution
    body = Body(
        settings.sensor_range / cell,
        min(360.0, 360 * laser.span / TURN),
        settings.speed * settings.step_s / cell,
        radius_cells=settings.radius / cell,
        laser=laser,
    )
    bodies = [body] * settings.robots
    for other in settings.teammate:
        reach = body.range_cells if other.sensor_range is None else other.sensor_range / cell
        radius = body.radius_cells if other.radius is None else other.radius / cell
        bodies[other.robot] = replace(body, range_cells=reach, radius_cells=radius)
    team_bytes = max(1, round(settings.robots * settings.radio.rate * settings.step_s))
    return Settings(
        robot=settings.robot,
        bodies=tuple(bodies),
        width=settings.grid.columns,
        height=settings.grid.rows,
        beams=BEAMS,
        seed=settings.seed,
        strategy=settings.strategy,
        encoding=settings.encoding,
        replication=ReplicationSettings(GOSSIP, round_trip=2 * settings.radio.transit_steps(settings.step_s)),
        medium=MediumSettings(Budget(team_bytes)),
        options=settings.options,
        resolution=cell,
        min_frontier_cells=settings.min_frontier_size / cell,
        has_own_map=not settings.ros2.scan,
        incarnations=settings.starts,
    )


def absent_s(settings: RobotSettings) -> float:
    """Return the seconds of silence after which a teammate is not waited for at the end.

    On a slow radio, a teammate counts as in range for longer than `RobotSettings.absent_s`, and is waited for so long.
    """
    return max(settings.absent_s, settings.radio.timing().neighbor_timeout / SECOND)


def common_values(settings: RobotSettings) -> tuple[float, float, str]:
    """Return the values, besides settings of the control logic, that must be equal on all robots (`agent.field`).

    These are the left and lower edge of the grid, in meters, and the digest of the code: with another grid, maps of
    teammates would appear at a wrong place, and other code may decode them to wrong maps.
    """
    grid = settings.grid
    return grid.x + 0.0, grid.y + 0.0, code_digest()  # + 0.0: without the sign of -0.0


def robot_setup(settings: RobotSettings, started: Settings) -> RobotSetup:
    """Return what the records of a start name: `started` are the settings of this incarnation."""
    grid = settings.grid
    return RobotSetup(
        started,
        grid.x,
        grid.y,
        round(settings.step_s * SECOND),
        settings.radio.rate,
        time.time_ns() - time.monotonic_ns(),
        clock_id(),
    )


def pose_guard(settings: RobotSettings) -> PoseGuard:
    """Return the check of the robot's poses; within a step, the time of its scans is not known exactly."""
    cell = settings.grid.resolution
    slack = (JUMP_M + settings.speed * settings.step_s) / cell
    return PoseGuard(settings.speed / cell, slack)
