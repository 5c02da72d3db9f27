"""What robots of a team must have in common besides the settings of their control logic."""

from __future__ import annotations

from typing import Any

from agent.field import team_context
from deploy.field.robot_file import RobotSettings
from deploy.field.robot_plan import absent_s, agent_settings, common_values
from deploy.record.code_digest import code_digest
from protocol.range_scans import Laser
from tests.deploy.field.robot_processes import settings

LASER = Laser(4, 0, 49152, 8000)


def context(**grid: float) -> bytes:
    """Return what a robot seals its frames with, besides the key."""
    data: dict[str, Any] = settings(robots=2)
    data["grid"] |= grid
    robot = RobotSettings(**data)
    return team_context(agent_settings(robot, LASER), common_values(robot))


def test_robots_whose_grids_lie_elsewhere_do_not_accept_each_others_maps() -> None:
    assert context() == context(x=-1.0) == context(y=-1)
    assert len({context(), context(x=-1.1), context(y=-1.1)}) == 3
    assert context(x=0.0) == context(x=-0.0)


def test_a_teammate_in_range_of_a_slow_radio_is_waited_for() -> None:
    radio = {"medium": "serial", "serial_port": "/dev/ttyUSB0", "preset": "lora-sf12", "duty_cycle": 0.01}
    assert absent_s(RobotSettings(**settings(radio=radio))) > 1000
    assert absent_s(RobotSettings(**settings())) == 300


def test_robots_with_other_code_do_not_accept_each_others_maps() -> None:
    assert common_values(RobotSettings(**settings(robots=2)))[-1] == code_digest()
