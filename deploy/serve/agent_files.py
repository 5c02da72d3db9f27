"""Settings files for the agents of simulated robots (`murmur robot`), which may share a team with real robots."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomli_w

from agent.radios.team_key import create_key
from deploy.field.robot_file import RobotSettings
from deploy.scenario.errors import ScenarioError
from deploy.scenario.hardware import Hardware
from deploy.scenario.scenario import Scenario
from deploy.serve.process import ServeSettings
from deploy.serve.swarm import Swarm

KEY = "team.key"


@dataclass(frozen=True)
class AgentFiles:
    """Where to write the files, and what simulated and real robots of the team have in common.

    Raises ScenarioError if the team is too small, or a file to be written exists already.
    """

    folder: Path
    team: int
    """Size of the team; the simulated robots have its first numbers."""
    interface: str
    """The network interface of the radio."""
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        if self.team < len(self.names):
            raise ScenarioError(
                f"team = {self.team}: must be the number of all robots, of which {len(self.names)} are simulated"
            )
        for path in map(self.path, self.names):
            if path.exists():
                raise ScenarioError(
                    f"write-robots = {self.folder}: {path} already exists; name a new directory"
                )

    def path(self, name: str) -> Path:
        """Return the settings file of a robot."""
        return self.folder / f"{name}.toml"

    def write(self, scenario: Scenario, swarm: Swarm, served: ServeSettings) -> None:
        """Write all files, and a key if there is none; ScenarioError or KeyFileError if one cannot be written."""
        key = self.folder / KEY
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            if not key.exists():
                create_key(key)
            for robot, name in enumerate(self.names):
                radio = {"medium": "udp", "interface": self.interface, "key": KEY}
                settings = file_settings(scenario, swarm, served, robot) | {
                    "robots": self.team,
                    "radio": radio,
                }
                settings["record"] = {"folder": name}
                RobotSettings(**settings)
                self.path(name).write_text(tomli_w.dumps(settings), encoding="utf-8")
        except OSError as error:
            raise ScenarioError(f"write-robots = {self.folder}: {error.strerror}") from None


def file_settings(scenario: Scenario, swarm: Swarm, served: ServeSettings, robot: int) -> dict[str, Any]:
    """Return what the settings file of a robot's agent needs, besides radio and records."""
    hardware, (x, y, yaw) = scenario.body_of(robot), swarm.robots[robot].start
    settings: dict[str, Any] = {
        "robot": robot, "robots": scenario.robots, "sensor_range": hardware.sensor_range,
        "speed": hardware.speed, "radius": hardware.radius, "grid": grid(swarm),
        "ros2": {
            "namespace": served.namespaces[robot],
            "map_pose": [round(x, 3), round(y, 3), round(math.degrees(yaw), 1)],
            "router": served.router, "domain": served.domain, "distro": served.distro,
        },
    }  # fmt: skip
    others = (scenario.body_of(other) for other in range(scenario.robots))
    teammates = [
        _teammate(other) for other in others if _teammate(other) | {"robot": robot} != _teammate(hardware)
    ]
    return settings | ({"teammate": teammates} if teammates else {})


def _teammate(hardware: Hardware) -> dict[str, Any]:
    return {"robot": hardware.robot, "sensor_range": hardware.sensor_range, "radius": hardware.radius}


def grid(swarm: Swarm) -> dict[str, float]:
    """Return the grid of the true map in the common frame, in meters."""
    frame = swarm.world.frame
    return {
        "x": frame.x, "y": frame.y, "width_m": round(frame.width * frame.resolution, 6),
        "height_m": round(frame.height * frame.resolution, 6), "resolution": frame.resolution,
    }  # fmt: skip
