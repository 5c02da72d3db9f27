"""The world's shell, the step barrier: it opens a step, waits until all robots have moved, opens the next."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping

import numpy as np

from protocol import keys as names
from protocol import messages, rights
from protocol.bus import Bus, Message
from protocol.errors import ProtocolError
from protocol.fields import MOST_WORD, clip
from protocol.keys import Keys
from protocol.messages import (
    Back,
    Begin,
    Close,
    End,
    FaultEvent,
    Lost,
    Move,
    Positions,
    Record,
    Shutdown,
    Stop,
    Watched,
    WorldReport,
    pack,
)
from protocol.rights import MAX_PROTOCOL_ERRORS, TOO_MANY_ERRORS
from worldsim.continuous_motion import FINE
from worldsim.faults import KINDS
from worldsim.world import World

EXPLORED, OUT_OF_STEPS, ALL_LOST = "explored", "out of steps", "all robots are lost"
STALLED = "stalled: there is a frontier left, and no robot gets nearer to it"


class WorldNode:
    """One run's world; `done` once it may shut down.

    Parameters
    ----------
    steps : int
        The last step.
    cell_mm : float
        Side of a cell in millimetres, for reports.
    wait : callable, optional
        Called before each step is opened: it may delay the step, so that people can watch (`worldsim.pace`).
    revive : bool
        Whether to restart robots whose processes die unexpectedly.
    incarnations : int
        How often each robot may start: once, and once more for each restart.
    """

    def __init__(
        self,
        bus: Bus,
        keys: Keys,
        world: World,
        steps: int,
        cell_mm: float,
        *,
        wait: Callable[[], object] = lambda: None,
        revive: bool = False,
        incarnations: int = 1,
    ) -> None:
        self.done = False
        self._bus = bus
        self._keys = keys
        self._world = world
        self._to = {robot: keys.body(names.robot(robot), names.WORLD) for robot in world.cells}
        self._steps = steps
        self._cell_mm = cell_mm
        self._wait = wait
        self._revive = revive
        self._left = dict.fromkeys(world.cells, incarnations - 1)
        """How often each robot may still be started again."""
        self._coming: set[int] = set()
        """Robots that were lost unasked, and are being started again."""
        self._moves: dict[int, Move] = {}
        self._gone: set[int] = set()
        """Robots whose processes have ended, as the relay said."""
        self._back: set[int] = set()
        """Robots that have come back, and have not been let into the world yet."""
        self._restarting: set[int] = set()
        """Robots without which the next step does not begin, for it is the one in which they come back."""
        self._held: dict[int, Move] = {}
        """The moves of the step that waits for them."""
        self._stop = ""
        self._running = False
        self._watched = False
        self._closed = False
        """Whether the medium of this step is: then all robots are to move."""
        self._protocol_errors: Counter[str] = Counter()
        """How often each participant has made no sense in this step."""

    def handle(self, message: Message) -> None:
        """Take one message from the bus."""
        try:
            said = rights.read(*message)
            if isinstance(said, Move):
                self._take_move(names.number(names.parts(message.key)[3]), said)
            else:
                self._take_note(said)
        except ProtocolError as error:
            self._fault(names.parts(message.key)[3], str(error))
        while self._running and not self._restarting and len(self._moves) >= self._world.awake_count:
            self._end_step()

    @property
    def phase(self) -> tuple[object, ...]:
        """What the world waits for: all moves of a step whose medium is closed, or those who are to come back."""
        return self._world.step, self._closed, len(self._restarting)

    def waiting_for(self) -> list[int]:
        """Robots whose moves the world is waiting for."""
        if self._restarting:
            return sorted(self._restarting - self._back)
        return sorted({*self._world.awake()} - self._moves.keys()) if self._running and self._closed else []

    def give_up_on(self, robot: int, cause: str) -> None:
        """Have the relay go on without a robot: then it is lost to all."""
        self._bus.put(self._keys.control_tx(names.WORLD), pack(Lost(robot, cause)))
        if robot in self._restarting:
            self._restarting.discard(robot)
            self._back.discard(robot)
            if self._restarting:
                self._restart()
            else:
                self._advance()

    def _take_note(self, said: object) -> None:
        if isinstance(said, Begin):
            self._begin()
        elif isinstance(said, Lost):
            self._take_loss(said.robot)
        elif isinstance(said, Close):
            self._closed = said.step == self._world.step
        elif isinstance(said, Back):
            self._back.add(said.robot)
            self._gone.discard(said.robot)
            self._coming.discard(said.robot)
            self._restart()
        elif isinstance(said, FaultEvent):
            self._schedule(said)
        elif isinstance(said, Stop):
            self._stop = said.reason
            if self._running and self._restarting:
                self._end(self._stop, -1)
        elif isinstance(said, Watched):
            self._watched = said.here
        elif isinstance(said, Shutdown):
            self.done = True

    def _begin(self) -> None:
        self._running = True
        self._open_step({})

    def _take_move(self, robot: int, move: Move) -> None:
        """Take a living robot's move, its first of this step."""
        step = self._world.step
        if not self._running or move.step != step:
            raise ProtocolError("Move", 0, f"for step {move.step}, while step {step} is under way")
        if robot in self._moves:
            raise ProtocolError("Move", 0, f"a second one for step {step}")
        if robot in self._world.cells and robot not in self._world.active_faults["stop"]:
            self._moves[robot] = move

    def _end_step(self) -> None:
        moves, self._moves = self._moves, {}
        explored = sorted(robot for robot, move in moves.items() if move.explored)
        wanted = 1
        if self._world.settings.ends_with_all:
            wanted = len(moves)
        elif explored:
            explored = [robot for robot in self._world.smallest_robots() if robot in explored]
        if explored and len(explored) >= wanted:
            self._end(EXPLORED, explored[0])
        elif self._world.hopeless() and not self._back and not self._coming:
            self._end(ALL_LOST, -1)
        elif moves and all(move.stalled for move in moves.values()):
            self._end(STALLED, -1)
        elif self._stop:
            self._end(self._stop, -1)
        elif self._world.step >= self._steps:
            self._end(OUT_OF_STEPS, -1)
        else:
            self._open_step(moves)

    def _open_step(self, moves: Mapping[int, Move]) -> None:
        self._wait()
        self._closed = False
        self._protocol_errors.clear()
        for fault in self._world.due_faults():
            self._apply(fault)
        self._held = dict(moves)
        if self._world.hopeless():
            self._restarting |= self._coming  # there is nobody else
        if self._restarting:
            self._restart()
        else:
            self._advance()

    def _schedule(self, event: FaultEvent) -> None:
        """Schedule a fault that was requested during the run; one without a step occurs in the next."""
        world = self._world
        known = event.kind in KINDS and event.robot < len(self._to)
        if not known:
            self._report(messages.Fault(names.RECORDER, f"not a fault of a robot of this run: {event}"))
        elif event.kind == "restart" and not self._left[event.robot]:
            self._report(messages.Fault(names.RECORDER, f"robot {event.robot} cannot be restarted again"))
        else:
            fault = FaultEvent(max(event.step, world.step + 1), event.robot, event.kind, event.steps)
            world.faults = sorted([*world.faults, fault])

    def _apply(self, fault: FaultEvent) -> None:
        """Have a fault come true, and report it; a robot that is gone is past it."""
        robot, here = fault.robot, fault.robot in self._world.cells
        step = self._world.step + 1
        if fault.kind == "restart":
            self._restarting.add(robot)
            self._left[robot] -= 1
        if here and fault.kind in ("kill", "restart"):
            killed = FaultEvent(step, robot, "kill")
            self._report(killed)
            self._tell(robot, killed)
            self._lose(robot)
        elif here and fault.kind != "restart":
            self._report(FaultEvent(step, robot, fault.kind, fault.steps))
        if here and fault.kind == "death":
            self._tell(robot, End(self._world.step, "broken down, as the scenario has it", -1))
            self._lose(robot)

    def _take_loss(self, robot: int) -> None:
        """A robot's process has ended: as a fault had it, or unasked."""
        unasked = robot in self._world.cells or robot in self._back
        self._lose(robot)
        self._gone.add(robot)
        self._back.discard(robot)
        if unasked and self._revive and robot not in self._restarting and self._left[robot] > 0:
            self._left[robot] -= 1
            self._gone.discard(robot)
            self._coming.add(robot)
            self._report(FaultEvent(self._world.step, robot, "restart"))
        self._restart()

    def _lose(self, robot: int) -> None:
        self._world.lose(robot)
        self._moves.pop(robot, None)
        self._held.pop(robot, None)

    def _restart(self) -> None:
        """Have those started that are to come back, once they have ended; go on when all are here."""
        for robot in sorted(self._restarting & self._gone):
            self._gone.discard(robot)
            self._report(FaultEvent(self._world.step + 1, robot, "restart"))
        if self._running and self._restarting and self._restarting <= self._back:
            self._restarting.clear()
            self._advance()

    def _advance(self) -> None:
        """Open the next step: tell the relay first, then each robot what it sees as soon as that is known."""
        world = self._world
        for robot in sorted(self._back):
            world.revive(robot)
        self._back.clear()
        moves, self._held = self._held, {}
        senses = world.drive(moves)
        robots = world.awake()
        x, y = ([world.cells[robot][axis] for robot in robots] for axis in range(2))
        ill = [sorted(world.active_faults[kind]) for kind in ("mute", "deaf")]
        positions = Positions(world.step, robots, x, y, *ill)
        self._bus.put(self._keys.control_tx(names.WORLD), pack(positions))
        for robot, sense in senses:
            self._tell(robot, sense)
        self._report(self._truth())

    def _fault(self, who: str, what: str) -> None:
        """Report what made no sense; who says too much of it is given up."""
        self._protocol_errors[who] += 1
        if self._protocol_errors[who] <= MAX_PROTOCOL_ERRORS:
            self._report(messages.Fault(who[:MOST_WORD], clip(what)))
        elif self._protocol_errors[who] == MAX_PROTOCOL_ERRORS + 1 and names.is_robot(who):
            self.give_up_on(names.number(who), TOO_MANY_ERRORS)

    def _report(self, message: Record) -> None:
        """Tell the laboratory, and the viewer if there is one."""
        payload = pack(message)
        self._bus.put(self._keys.control(names.RECORDER, names.WORLD), payload)
        if self._watched:
            self._bus.put(self._keys.control(names.VIEW, names.WORLD), payload)

    def _truth(self) -> WorldReport:
        world = self._world
        poses = np.array(
            [
                (robot, *self._millimetres(robot), world.headings[robot] * 450)
                for robot in sorted(world.cells)
            ],
            "<i4",
        ).reshape(-1, 4)
        driven = [round(cells * self._cell_mm) for cells in world.driven]
        return WorldReport(world.step, poses.tobytes(), driven, world.seen_cells, world.reachable_cells)

    def _millimetres(self, robot: int) -> tuple[int, int]:
        """A robot's position."""
        (x, y), (offset_x, offset_y) = self._world.cells[robot], self._world.offsets[robot]
        scale = self._cell_mm / FINE
        return round((x * FINE + offset_x) * scale), round((y * FINE + offset_y) * scale)

    def _end(self, reason: str, first: int) -> None:
        self._running = False
        end = pack(End(self._world.step, reason, first))
        self._bus.put(self._keys.control_tx(names.WORLD), end)

    def _tell(self, robot: int, message: Record) -> None:
        self._bus.put(self._to[robot], pack(message))
