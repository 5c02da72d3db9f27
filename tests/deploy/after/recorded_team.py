"""A team in virtual time of which every robot records, by a clock of its own."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from agent.radios.options import LinkOptions
from agent.radios.peer_medium import FrameRecord
from deploy.record.field_records import FieldRecorder, RobotSetup
from deploy.scenario.plan import Plan
from protocol.nanoseconds import SECOND
from tests.agent.radios.air_team import AirTeam
from tests.agent.radios.memory_air import MemoryAir

CORNER = -5.0, 2.0
"""The lower left corner of the team's grid in the common frame."""
RATE = 1000


class RecordedTeam(AirTeam):
    """Each robot records to ``folder/rN/start-S``; its clock is ahead by `ahead` nanoseconds."""

    def __init__(self, plan: Plan, air: MemoryAir, folder: Path, ahead: Mapping[int, int]) -> None:
        def set_time(now: int) -> None:
            air.now = now

        self.recorders: dict[int, FieldRecorder] = {}
        self._folder, self._ahead = folder, ahead
        options = LinkOptions("udp", interface="lo", bytes_per_s=RATE)
        super().__init__(plan, options, lambda number: air.join(number, 1400), folder / "state", set_time)

    def play(self, *, moving: bool = True, ticks: int = 20) -> None:
        """Play one step of a second, and record it."""
        super().play(moving=moving, ticks=ticks)
        for number, member in self.members.items():
            member.field.begin += self._ahead[number]
            self.recorders[number].note(self.step - member.began, member.field, work_us=1000 + number)

    def end(self, number: int, reason: str = "nothing is left", *, is_complete: bool = True) -> None:
        """Close the record of a robot."""
        self.recorders[number].close(self.members[number].field, reason, is_complete=is_complete)

    def start(self, number: int) -> None:
        """Start the process of a robot, and its record."""
        super().start(number)
        member = self.members[number]
        started, ahead = member.robot.settings, self._ahead[number]
        setup = RobotSetup(started, *CORNER, SECOND, RATE, utc_ns=-ahead, clock=f"host {number}")
        folder = self._folder / f"r{number}" / f"start-{started.incarnation + 1}"
        recorder = self.recorders[number] = FieldRecorder(folder, setup)

        def record(step: int, frames: list[FrameRecord]) -> None:
            recorder.record(step, [each._replace(time=each.time + ahead) for each in frames])

        member.field.record = record
