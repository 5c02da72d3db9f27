"""The commands that control a run in progress: those of the keyboard, and of the page with the dashboard."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from deploy.run.control import Control
from protocol.budget import WORD_FOR_UNLIMITED

SPEEDS = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
"""Speeds in steps per second; above the last one, the speed is unlimited."""


class LiveCommands:
    """Performs commands on a run, by name, from any thread."""

    def __init__(self, control: Control) -> None:
        self.has_ended = False
        """Whether the run is over, so that no command has an effect."""
        self._control = control
        self._commands: dict[str, Callable[[str], str]] = {
            "pause": self._pause, "resume": self._resume, "step": self._step,
            "faster": lambda _: self._change_speed(faster=True),
            "slower": lambda _: self._change_speed(faster=False),
            "kill": self._kill, "bandwidth": self._bandwidth, "range": self._range,
        }  # fmt: skip

    def perform(self, command: str, value: str = "") -> str:
        """Perform a command; return a message on its effect.

        Raises ValueError if the command does not exist, its value is invalid, or the run is over.
        """
        if command not in self._commands:
            raise ValueError(f"command = {command!r}: must be one of {', '.join(self._commands)}")
        if self.has_ended:
            raise ValueError("the run is over")
        return self._commands[command](value.strip())

    def state(self) -> dict[str, Any]:
        """Return the state of the run for a page that shows it."""
        control = self._control
        return {
            "step": control.step_now,
            "paused": control.paused,
            "speed": control.speed,
            "robots": control.robots,
            "ended": self.has_ended,
        }

    def _pause(self, _: str) -> str:
        self._control.pause()
        return "paused"

    def _resume(self, _: str) -> str:
        self._control.resume()
        return "running"

    def _step(self, _: str) -> str:
        self._control.step()
        return "one step, then paused"

    def _change_speed(self, *, faster: bool) -> str:
        self._control.set_speed(_next_speed(self._control.speed, faster=faster))
        speed = self._control.speed
        return f"{speed:g} steps/s" if speed else "unlimited speed"

    def _kill(self, robot: str) -> str:
        if not robot.isdecimal():
            raise ValueError(f"kill: {robot!r} is not a robot number")
        self._control.kill(int(robot))
        return f"robot {robot} will be killed at the next step"

    def _bandwidth(self, value: str) -> str:
        self._control.change(bandwidth=value)
        return f"bandwidth {value}{'' if value == WORD_FOR_UNLIMITED else ' B'} from the next step"

    def _range(self, value: str) -> str:
        self._control.change(range=value)
        return f"range {value} from the next step"


def _next_speed(now: float | None, *, faster: bool) -> float | None:
    if faster:
        return next((speed for speed in SPEEDS if now is not None and speed > now), None)
    return next((speed for speed in reversed(SPEEDS) if now is None or speed < now), SPEEDS[0])
