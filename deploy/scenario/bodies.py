"""Bodies and sensors of the robots, in cells, from their hardware in meters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from msgspec.structs import replace

from deploy.scenario.errors import ScenarioError
from deploy.scenario.hardware import Hardware
from deploy.scenario.recording import Recording
from deploy.scenario.team_settings import TeamSettings
from protocol.body import Body
from protocol.grid import MAX_SIDE, disc
from protocol.range_scans import MAX_REACH_M, TURN, Laser
from worldsim.sensors import RobotSensors, SensorSettings


def bodies_of(
    team: TeamSettings, cell: float, recording: Recording | None = None, *, noisy: bool
) -> list[Body]:
    """Return the body of each robot, with cells of `cell` meters.

    Bodies have lasers with beams if sensors are `noisy`, or if robots replay a recording. Raises ScenarioError if a
    robot is too large for the map, or its sensor range too short for its size.
    """
    bodies = []
    for robot in range(team.robots):
        hardware = team.body_of(robot)
        body = _body(hardware, cell)
        if recording is not None:
            body = replace(body, speed=max(recording.speed_cells, 1.0), laser=recording.lasers[robot])
        elif noisy:
            body = replace(body, laser=laser_of(hardware, team.beams))
        bodies.append(body)
    return bodies


def sensors_of(team: TeamSettings, bodies: Sequence[Body], cell: float) -> SensorSettings | None:
    """Return the real sensors of the robots, with cells of `cell` meters; None if lasers and poses are exact."""
    robots = []
    for robot, body in enumerate(bodies):
        hardware = team.body_of(robot)
        if body.laser is None:
            return None
        robots.append(RobotSensors(hardware.laser, hardware.pose, body.laser))
    return SensorSettings(tuple(robots), cell)


def laser_of(hardware: Hardware, beams: int) -> Laser:
    """Return the beams of a robot's laser, from the right to the left end of its field of view.

    `beams` is their number over a full turn, for a laser that has no number of its own.
    """
    laser, view = hardware.laser, hardware.field_of_view
    span = round(view / 360 * TURN)
    count = laser.beams or max(2, round(beams * view / 360))
    if view == 360:  # the last beam would repeat the first
        span -= span // count
    reach_m = min(hardware.sensor_range, laser.max_range_m or MAX_REACH_M, MAX_REACH_M)
    return Laser(count, -span // 2, span, round(1000 * reach_m))


def _body(hardware: Hardware, cell: float) -> Body:
    number, sensor_range, radius = hardware.robot, hardware.sensor_range, hardware.radius
    if sensor_range < cell:
        raise ScenarioError(
            f"sensor_range = {sensor_range:g} m of robot {number} is less than a cell of {cell:g} m"
        )
    if radius > MAX_SIDE * cell:
        raise ScenarioError(f"radius = {radius:g} m: exceeds the largest map with cells of {cell:g} m")
    if sensor_range < (least := least_range(radius / cell) * cell):
        raise ScenarioError(
            f"sensor_range = {sensor_range:g} m of robot {number} is less than {least:.3g} m: a disc of "
            f"radius = {radius:g} m would not see the walls that its next step touches"
        )
    return Body(
        sensor_range / cell,
        hardware.field_of_view,
        hardware.speed / cell,
        hardware.scanner_turn,
        radius / cell,
        scan_rate=hardware.laser.rate,
    )


def least_range(radius_cells: float) -> float:
    """Return the sensor range, in cells, with which a disc sees all cells that its next step may touch.

    It is 1 for robots so small that obstacles are not enlarged: these enter only cells that they have seen.
    """
    touched = disc(radius_cells)
    from_middle = np.argwhere(touched) - len(touched) // 2
    return float(np.hypot(*(from_middle + 1).T).max()) if len(from_middle) > 1 else 1.0
