"""The world's process: it opens a step, collects the robots' moves until the step ends, and opens the next.

`worldsim.barrier` decides when a step ends, `worldsim.ending` when the run does.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping

import numpy as np

from protocol import keys as names
from protocol import messages, rights
from protocol.bus import Bus, Message
from protocol.errors import ProtocolError
from protocol.faults import KINDS
from protocol.grid import FINE
from protocol.keys import Keys
from protocol.message_codec import pack
from protocol.message_fields import MAX_NAME, clip
from protocol.rights import MAX_PROTOCOL_ERRORS, TOO_MANY_ERRORS
from worldsim.barrier import Barrier
from worldsim.base import BaseWorld
from worldsim.clock import MOVE, STEP, StepClock
from worldsim.ending import Ending
from worldsim.restarts import Restarts


class WorldNode:
    """The world's end of the bus; `done` once the run is recorded and it may end.

    `steps` is the last step; cells are `cell_mm` wide in reports. `wait` is called before each step is opened, which it
    may delay. With `revive`, robots whose processes end unexpectedly are restarted; each robot may start `incarnations`
    times. `resend` sends the last messages to a robot again, after its connection was restored. `clock` ends the steps;
    by default, they wait for all robots.
    """

    def __init__(
        self,
        bus: Bus,
        keys: Keys,
        world: BaseWorld,
        steps: int,
        cell_mm: float,
        *,
        wait: Callable[[], object] = lambda: None,
        revive: bool = False,
        incarnations: int = 1,
        resend: Callable[[str], object] = lambda _: None,
        clock: StepClock | None = None,
    ) -> None:
        self.done = False
        self._bus = bus
        self._keys = keys
        self._world = world
        self._body_keys = {robot: keys.body(names.robot(robot), names.WORLD) for robot in world.cells}
        self._cell_mm = cell_mm
        self._wait = wait
        self._resend = resend
        self._restarts = Restarts(world.cells, incarnations - 1, automatic=revive)
        self._barrier = Barrier(world, self._restarts, StepClock() if clock is None else clock)
        self._ending = Ending(world, steps)
        self._has_viewer = False
        self._protocol_errors: Counter[str] = Counter()
        """Malformed or inconsistent messages in this step, by sender."""

    def handle(self, message: Message) -> None:
        """Process one message from the bus."""
        try:
            content = rights.read(*message)
            if isinstance(content, messages.Move):
                self._barrier.take_move(names.number(names.parts(message.key)[3]), content)
            else:
                self._take_note(content)
        except ProtocolError as error:
            self._report_error(names.parts(message.key)[3], str(error))
        self._end_steps()

    def deadline(self, now_ns: int) -> int | None:
        """Return the time at which `tick` should be called, in nanoseconds; None: never."""
        return self._barrier.deadline(now_ns)

    def tick(self, now_ns: int) -> None:
        """End the step if its time is over. Call this when no message is waiting."""
        self._barrier.clock.tick(now_ns)
        self._end_steps()

    @property
    def phase(self) -> tuple[object, ...]:
        """The state of the barrier: it changes whenever the run makes progress."""
        return self._barrier.phase

    def waiting_for(self) -> list[int]:
        """Return the robots that the next step waits for: for their return, or for their moves."""
        return self._barrier.waiting_for()

    def give_up_on(self, robot: int, cause: str) -> None:
        """Continue without a robot; the relay removes it from the run."""
        self._bus.put(self._keys.control_tx(names.WORLD), pack(messages.Lost(robot, cause)))
        if self._restarts.give_up_on(robot):
            if self._restarts.awaited:
                self._start_awaited()
            else:
                self._advance()

    def _take_note(self, note: object) -> None:
        """Process a message of the relay."""
        if isinstance(note, messages.Begin):
            self._barrier.running = True
            self._open_step({})
        elif isinstance(note, messages.Lost):
            self._take_loss(note.robot)
        elif isinstance(note, messages.Close):
            self._barrier.medium_closed = note.step == self._world.step
        elif isinstance(note, messages.Back):
            self._restarts.note_return(note.robot)
            self._start_awaited()
        elif isinstance(note, messages.Reconnected):
            self._resend(names.robot(note.robot))
        elif isinstance(note, messages.FaultEvent):
            self._schedule(note)
        elif isinstance(note, messages.Stop):
            self._ending.stop_reason = note.reason
            if self._barrier.running and self._restarts.awaited:
                self._end(messages.End(self._world.step, note.reason, -1))
        elif isinstance(note, messages.Watched):
            self._has_viewer = note.here
        elif isinstance(note, messages.Shutdown):
            self.done = True

    def _end_steps(self) -> None:
        """End the steps that are over: the current one, and further ones in which no robot takes part."""
        while self._barrier.step_is_over():
            self._end_step()

    def _end_step(self) -> None:
        """End the run if this step ends it, else open the next step."""
        moves = self._barrier.end_step()
        self._report_missed(MOVE, self._barrier.late)
        robots = len(self._world.present_robots())
        end = self._ending.check(moves, robots, deserted=self._barrier.is_deserted())
        for robot, reason in self._ending.take_early_reports():
            self._report(messages.ErrorReport(names.robot(robot), reason))
        if end is not None:
            self._end(end)
        else:
            self._open_step(moves)

    def _open_step(self, moves: Mapping[int, messages.Move]) -> None:
        """Apply the faults of the next step; open it unless restarts hold it."""
        self._wait()
        self._protocol_errors.clear()
        for fault in self._world.due_faults():
            self._apply(fault)
        self._barrier.hold(moves)
        if self._restarts.awaited:
            self._start_awaited()
        else:
            self._advance()

    def _schedule(self, event: messages.FaultEvent) -> None:
        """Schedule a fault that was requested during the run; one without a step occurs in the next."""
        known = event.kind in KINDS and event.robot < len(self._body_keys)
        if not known:
            self._report(messages.ErrorReport(names.RECORDER, f"not a fault of a robot of this run: {event}"))
        elif event.kind == "restart" and not self._restarts.may_restart(event.robot):
            reason = f"robot {event.robot} cannot be restarted again"
            self._report(messages.ErrorReport(names.RECORDER, reason))
        else:
            step = max(event.step, self._world.step + 1)
            self._world.faults.add(messages.FaultEvent(step, event.robot, event.kind, event.steps))

    def _apply(self, fault: messages.FaultEvent) -> None:
        """Apply a due fault and report it; only a restart applies to a robot that is gone."""
        robot, here = fault.robot, fault.robot in self._world.cells
        step = self._world.step + 1
        if fault.kind == "restart":
            self._restarts.request(robot)
        if here and fault.kind in ("kill", "restart"):
            killed = messages.FaultEvent(step, robot, "kill")
            self._report(killed)
            self._bus.put(self._keys.control_tx(names.WORLD), pack(killed))
            self._send(robot, killed)
            self._barrier.remove(robot)
        elif here:
            self._report(messages.FaultEvent(step, robot, fault.kind, fault.steps))
            if fault.kind == "death":
                self._barrier.remove(robot)

    def _take_loss(self, robot: int) -> None:
        """Process the end of a robot's process, by a fault or unexpected."""
        unexpected = robot in self._world.cells or robot in self._restarts.rejoined
        self._barrier.remove(robot)
        if self._restarts.note_end(robot, unexpected=unexpected):
            self._report(messages.FaultEvent(self._world.step, robot, "restart"))
        self._start_awaited()

    def _start_awaited(self) -> None:
        """Ask the launcher to restart awaited robots whose processes have ended; continue once all have rejoined."""
        for robot in self._restarts.take_startable():
            self._report(messages.FaultEvent(self._world.step + 1, robot, "restart"))
        if self._barrier.running and self._restarts.complete():
            self._advance()

    def _advance(self) -> None:
        """Open the next step: send the relay all positions, then each robot its scan as soon as it is computed."""
        world = self._world
        senses = world.move_robots(self._barrier.begin_step())
        robots = world.active_robots()
        x, y = ([world.cells[robot][axis] for robot in robots] for axis in range(2))
        positions = messages.Positions(world.step, robots, x, y)
        self._bus.put(self._keys.control_tx(names.WORLD), pack(positions))
        for robot, sense in senses:
            self._send(robot, sense)
        self._report(self._world_report())
        self._report_missed(STEP, sorted(world.absent))

    def _report_missed(self, phase: str, robots: list[int]) -> None:
        """Report the robots, if any, that miss a phase of this step."""
        if robots:
            self._report(messages.Missed(self._world.step, phase, 0, robots))

    def _report_error(self, sender: str, reason: str) -> None:
        """Report a malformed or inconsistent message; give up on a robot that sends too many in one step."""
        self._protocol_errors[sender] += 1
        if self._protocol_errors[sender] <= MAX_PROTOCOL_ERRORS:
            self._report(messages.ErrorReport(sender[:MAX_NAME], clip(reason)))
        elif self._protocol_errors[sender] == MAX_PROTOCOL_ERRORS + 1 and names.is_robot(sender):
            self.give_up_on(names.number(sender), TOO_MANY_ERRORS)

    def _report(self, message: messages.Record) -> None:
        """Send a message to the recorder, and to the viewer if there is one."""
        payload = pack(message)
        self._bus.put(self._keys.control(names.RECORDER, names.WORLD), payload)
        if self._has_viewer:
            self._bus.put(self._keys.control(names.VIEW, names.WORLD), payload)

    def _world_report(self) -> messages.WorldReport:
        world = self._world
        poses = np.array(
            [
                (robot, *self._millimeters(robot), world.headings[robot] * 450)
                for robot in sorted(world.cells)
            ],
            "<i4",
        ).reshape(-1, 4)
        driven = [round(cells * self._cell_mm) for cells in world.driven]
        people = np.rint(np.array(world.people).reshape(-1, 2) * self._cell_mm).astype("<i4").tobytes()
        return messages.WorldReport(
            world.step, poses.tobytes(), driven, world.seen_cells, world.reachable_cells, people
        )

    def _millimeters(self, robot: int) -> tuple[int, int]:
        (x, y), (offset_x, offset_y) = self._world.cells[robot], self._world.offsets[robot]
        scale = self._cell_mm / FINE
        return round((x * FINE + offset_x) * scale), round((y * FINE + offset_y) * scale)

    def _end(self, end: messages.End) -> None:
        self._barrier.running = False
        self._bus.put(self._keys.control_tx(names.WORLD), pack(end))

    def _send(self, robot: int, message: messages.Record) -> None:
        self._bus.put(self._body_keys[robot], pack(message))
