"""The loop of a robot in the field: from its first readings until nothing is left to explore, or it is stopped."""

from __future__ import annotations

import contextlib
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agent.field import FieldFiles, FieldRobot, drive
from agent.journal import JournalError
from agent.radios.peer_medium import FrameRecord
from agent.radios.team_key import read_key
from agent.radios.transport import Transport, wait
from agent.replication.control_packets import parse
from deploy.field.dropped_frames import DropAdvice, ErrorReporter
from deploy.field.range_report import RangeReport
from deploy.field.robot_file import RobotFile
from deploy.field.robot_plan import (
    absent_s,
    agent_settings,
    common_values,
    map_frame,
    pose_guard,
    robot_setup,
)
from deploy.field.ros2_robot import Ros2Robot
from deploy.field.running import running
from deploy.record.field_records import FieldRecorder
from deploy.record.number_texts import counted
from protocol.errors import ProtocolError
from protocol.nanoseconds import SECOND
from protocol.signals import ending_signals, handled

SLICE_NS = SECOND // 10
"""Nanoseconds after which a waiting robot looks for messages, signals, and the request to stop."""
STATUS_S, MARKERS_S, MAP_S = 1.0, 2.0, 2.0
"""Least seconds between two messages of a kind that the robot publishes."""
PATIENCE_S = 3.0
"""Seconds for which the first readings are awaited without a message."""
FREEZE = 0.5
"""Part of `finish_s` after which an explored map does not change any more: noise would always add entries to send."""
NEWS_CELLS = 100
"""A teammate lacks something if this robot has mapped more cells than this out of its range: noise changes a few."""
EXPLORED = "nothing is left to explore, and teammates hold this robot's map"

Say = Callable[[str], None]
"""Shows a line to the user."""


@dataclass(frozen=True)
class MissionEnd:
    """How a mission ended: the reason, and whether everything is explored and delivered."""

    reason: str
    is_complete: bool
    steps: int = 0
    records: Path | None = None


class StoppedError(Exception):
    """The robot is to stop now, within a step."""


class StopRequest:
    """The request to end: a signal, or a file."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self._signal = ""

    @property
    def reason(self) -> str:
        """Why to end; empty: not yet."""
        return self._signal or ("murmur stop" if self._file.exists() else "")

    @contextlib.contextmanager
    def signals(self) -> Iterator[None]:
        """Take the signals that end a process as requests (main thread only)."""
        with handled(ending_signals(), self._come):
            yield

    def _come(self, number: int, _: object) -> None:
        self._signal = signal.Signals(number).name


def explore(file: RobotFile, say: Say) -> MissionEnd:
    """Run one robot until its mission ends; whatever happens, it then stands still.

    ValueError: key, session file, journal, interface, port, or router cannot be used; the message says what to do.
    """
    key = read_key(file.key)
    with contextlib.ExitStack() as stack:
        stop = StopRequest(stack.enter_context(running(file.record)))
        stack.enter_context(stop.signals())
        transport = file.settings.radio.open_transport()
        stack.callback(transport.close)
        ros = Ros2Robot(file.settings)
        stack.callback(ros.close)
        if not wait_for_readings(ros, stop, say):
            return MissionEnd(f"stopped by {stop.reason}", is_complete=False)
        return Mission(file, key, ros, transport, stop, say).run()


def wait_for_readings(ros: Ros2Robot, stop: StopRequest, say: Say) -> bool:
    """Wait for the first laser scan, or the first map and pose; return False if the robot is to stop before."""
    shown, begin = "", time.monotonic()
    while not stop.reason:
        ros.spin(SLICE_NS / SECOND)
        if ros.laser is not None:
            return True
        if (problem := ros.problem) != shown and time.monotonic() - begin > PATIENCE_S:
            say(f"waiting: {problem}")
            shown = problem
    return False


class Mission:
    """One start of a robot, from its first readings on."""

    def __init__(
        self, file: RobotFile, key: bytes, ros: Ros2Robot, transport: Transport, stop: StopRequest, say: Say
    ) -> None:
        settings = file.settings
        assert ros.laser is not None
        agent = agent_settings(settings, ros.laser)
        files = FieldFiles.open(file.record, key, agent, file.sessions)
        self._settings, self._ros, self._transport = settings, ros, transport
        self._stop, self._say = stop, say
        self._step_ns = round(settings.step_s * SECOND)
        try:
            self._field = FieldRobot(
                agent, settings.radio, files, ros, transport, pose_guard(settings), time.monotonic_ns(),
                ErrorReporter(say), self._end_step, common_values(settings),
            )  # fmt: skip
        except JournalError as error:
            raise ValueError(
                f"{file.record}: {error}; for a new mission, choose a new record.folder"
            ) from None
        started = self._field.robot.settings
        self._recorder = FieldRecorder(
            file.record / f"start-{started.incarnation + 1}", robot_setup(settings, started)
        )
        self._step = 0
        self._drop_advice = DropAdvice(settings.robot, settings.robots)
        self._began = time.monotonic_ns()
        timeout = settings.radio.timing().neighbor_timeout
        self._range_report = RangeReport(settings.robots - 1, timeout, self._began)
        self._known_in_range: dict[int, int] = {}
        """Cells that this robot knew when each teammate was last in range."""
        self._worked_ns = time.process_time_ns()
        """Processor time of this process up to the last step."""
        self._explored_steps = 0
        """Steps for which nothing has been left to explore."""
        self._done_steps = 0
        """Steps for which nothing has been left to explore or to deliver, and no teammate has sent entries, which need
        this robot's acknowledgments."""
        self._reason, self._is_complete = "", False
        self._published: dict[str, int] = {}
        self._shown = ""
        """The last status that the user was shown."""

    def run(self) -> MissionEnd:
        """Play steps until the end."""
        robots = self._settings.robots
        self._say(f"robot {self._settings.robot} of {robots} explores; records in {self._recorder.folder}")
        try:
            late = drive(self._field, self._step_ns, time.monotonic_ns, self._wait, self._is_over)
            if late:
                self._say(f"{counted(late, 'step')} took longer than {self._settings.step_s:g} s")
        except StoppedError:
            pass
        finally:
            self._recorder.record(self._step, self._field.medium.records)
            self._recorder.close(self._field, self._reason or "aborted", is_complete=self._is_complete)
        if self._field.move is not None:
            self._published.clear()
            self._publish(self._reason)
        return MissionEnd(self._reason, self._is_complete, self._step, self._recorder.folder)

    def _wait(self, duration: int) -> None:
        """Wait for a slice of a step at most, or until a frame arrives, and take the messages of the robot."""
        wait(self._transport, min(duration, SLICE_NS))
        self._ros.spin()
        if not self._reason and self._is_stopped():
            raise StoppedError

    def _is_stopped(self) -> bool:
        reason = self._stop.reason
        if reason:
            self._reason = f"stopped by {reason}"
        return bool(reason)

    def _is_over(self, step: int) -> bool:
        """Return whether the mission ends after `step` steps, and note the reason."""
        self._step = step
        finish = max(1, round(self._settings.finish_s / self._settings.step_s))
        if self._is_stopped():
            return True
        if self._done_steps >= finish:
            self._reason, self._is_complete = self._explored(), True
        elif step >= self._settings.steps:
            self._reason = f"{counted(step, 'step')} {'is' if step == 1 else 'are'} over"
        return bool(self._reason)

    def _end_step(self, step: int, records: list[FrameRecord]) -> None:
        """Record and publish at the end of a step, and avoid a target that the robot does not reach."""
        self._step = step
        self._recorder.record(step, records)
        field = self._field
        robot = field.robot
        receives = any(each.sender != self._settings.robot and _has_entries(each.gossip) for each in records)
        explored = field.move is not None and field.move.explored
        self._explored_steps = self._explored_steps + 1 if explored else 0
        self._ros.measures = self._explored_steps * self._settings.step_s < FREEZE * self._settings.finish_s
        neighbors = field.medium.neighbors.current(time.monotonic_ns())
        self._known_in_range |= dict.fromkeys(neighbors, robot.known_cells)
        is_done = explored and self._lacking() <= self._absent() and not receives
        self._done_steps = self._done_steps + 1 if is_done else 0
        if self._ros.is_stuck() and robot.target is not None:
            seconds = self._settings.avoid_s
            x, y = map_frame(self._settings).position(robot.target[0] + 0.5, robot.target[1] + 0.5)
            where = f"({x:.2f}, {y:.2f}) m in the common frame"
            self._say(f"does not reach its target at {where}: avoids it for {seconds:g} s or longer")
            robot.avoid(robot.target, max(1, round(seconds / self._settings.step_s)))
        if (status := self._activity()) != self._shown:
            self._shown = status
            self._say(status)
        for advice in self._drop_advice.new(field.medium.dropped):
            self._say(advice)
        if self._settings.robots > 1:
            ended = field.medium.neighbors.ended()
            for line in self._range_report.new(neighbors, ended, field.unsent, time.monotonic_ns()):
                self._say(line)
        worked, self._worked_ns = self._worked_ns, time.process_time_ns()
        self._recorder.note(step, field, status, (self._worked_ns - worked) // 1000)
        self._publish(status)

    def _lacking(self) -> set[int]:
        """Return the teammates that lack entries of this robot's map, or cells that it has mapped out of their range.

        A robot without teammates in range may log nothing: later entries can be shorter.
        """
        robot, known = self._field.robot, self._known_in_range
        return {
            other
            for other in self._teammates
            if robot.replication.undelivered_to(other) or robot.known_cells - known.get(other, 0) > NEWS_CELLS
        }

    def _absent(self) -> set[int]:
        """Return the teammates that have not been received for a long time (`absent_s`), and are not waited for."""
        since = time.monotonic_ns() - round(absent_s(self._settings) * SECOND)
        last = self._field.medium.neighbors.last
        return {robot for robot in self._teammates if (last(robot) or self._began) <= since}

    @property
    def _teammates(self) -> list[int]:
        """The teammates that have not said that they have ended."""
        gone = {self._settings.robot, *self._field.medium.neighbors.ended()}
        return [robot for robot in range(self._settings.robots) if robot not in gone]

    def _explored(self) -> str:
        """Return the reason of the end if nothing is left to explore."""
        lacking = sorted(self._lacking())
        if not lacking:
            return EXPLORED
        names = ", ".join(map(str, lacking))
        silence = f"robots not received for {absent_s(self._settings):g} s lack this robot's map: {names}"
        return f"nothing is left to explore; {silence}"

    def _activity(self) -> str:
        """Return what the robot does, as text."""
        if self._field.move is None:
            cause = (
                "its pose has jumped"
                if self._field.has_jumped
                else "its pose was not known in time for this step"
            )
            return f"stands still: {self._ros.problem or cause}"
        return self._ros.problem or self._field.robot.status

    def _publish(self, status: str) -> None:
        """Publish what is due."""
        if self._is_due("status", STATUS_S):
            self._ros.publish_status(self._status(status))
        if self._is_due("map", MAP_S):
            self._ros.publish_map(self._field.robot)
        if self._is_due("markers", MARKERS_S):
            self._ros.publish_markers(self._field.robot)

    def _is_due(self, name: str, interval_s: float) -> bool:
        now = time.monotonic_ns()
        if now - self._published.get(name, -SECOND * 3600) < interval_s * SECOND:
            return False
        self._published[name] = now
        return True

    def _status(self, status: str) -> dict[str, Any]:
        """Return the status that is published."""
        field = self._field
        robot, medium = field.robot, field.medium
        return {
            "robot": self._settings.robot,
            "step": self._step,
            "status": status,
            "explored": field.move is not None and field.move.explored,
            "known_cells": robot.known_cells,
            "target": robot.target,
            "neighbors": medium.neighbors.current(time.monotonic_ns()),
            "ended": sorted(medium.neighbors.ended()),
            "undelivered": robot.replication.undelivered(),
            "dropped": medium.dropped,
            "unsent": field.unsent,
        }


def _has_entries(gossip: bytes) -> bool:
    """Return whether a teammate's gossip has entries of a map, not only reports."""
    try:
        return bool(parse(gossip).sections)
    except ProtocolError:
        return False
