"""The world's shell, the step barrier: it opens a step, waits until all robots have moved, opens the next."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from protocol import keys as names
from protocol import rights
from protocol.bus import Bus, Message
from protocol.errors import ProtocolError
from protocol.fields import MOST_WORD, clip
from protocol.keys import Keys
from protocol.messages import (
    Begin,
    Bye,
    Close,
    Configure,
    End,
    Fault,
    Lost,
    Move,
    Positions,
    Record,
    Stop,
    Watched,
    WorldReport,
    pack,
)
from protocol.rights import BABBLES, MOST_NONSENSE
from worldsim.continuous_motion import FINE
from worldsim.world import World

EXPLORED, OUT_OF_STEPS, ALL_LOST = "explored", "out of steps", "all robots are lost"
STALLED = "stalled: there is a frontier left, and no robot gets nearer to it"


class WorldNode:
    """One run's world; `done` once it may shut down.

    Parameters
    ----------
    minds : mapping
        The settings that each robot receives before its first step (`Configure.settings`).
    steps : int
        The last step.
    cell_mm : float
        Side of a cell in millimetres, for reports.
    wait : callable, optional
        Called before each step is opened: it may delay the step, so that people can watch (`worldsim.pace`).
    """

    def __init__(
        self,
        bus: Bus,
        keys: Keys,
        world: World,
        minds: Mapping[int, Mapping[str, Any]],
        steps: int,
        cell_mm: float,
        *,
        wait: Callable[[], object] = lambda: None,
    ) -> None:
        self.done = False
        self._bus = bus
        self._keys = keys
        self._world = world
        self._minds = minds
        self._steps = steps
        self._cell_mm = cell_mm
        self._wait = wait
        self._moves: dict[int, Move] = {}
        self._stop = ""
        self._running = False
        self._watched = False
        self._closed = False
        """Whether the medium of this step is: then all robots are to move."""
        self._nonsense: Counter[str] = Counter()
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
        while self._running and self._moves.keys() >= self._world.cells.keys():
            self._end_step()

    @property
    def phase(self) -> tuple[object, ...]:
        """What the world waits for: all moves of a step whose medium is closed."""
        return self._world.step, self._closed

    def waiting_for(self) -> list[int]:
        """Robots whose moves the world is waiting for."""
        late = self._world.cells.keys() - self._moves.keys() if self._running and self._closed else ()
        return sorted(late)

    def give_up_on(self, robot: int, cause: str) -> None:
        """Have the relay go on without a robot: then it is lost to all."""
        self._bus.put(self._keys.control_tx(names.WORLD), pack(Lost(robot, cause)))

    def _take_note(self, said: object) -> None:
        if isinstance(said, Begin):
            self._begin()
        elif isinstance(said, Lost):
            self._world.lose(said.robot)
            self._moves.pop(said.robot, None)
        elif isinstance(said, Close):
            self._closed = said.step == self._world.step
        elif isinstance(said, Stop):
            self._stop = said.reason
        elif isinstance(said, Watched):
            self._watched = said.here
        elif isinstance(said, Bye):
            self.done = True

    def _begin(self) -> None:
        for robot, settings in sorted(self._minds.items()):
            self._tell(robot, Configure(dict(settings)))
        self._running = True
        self._open_step({})

    def _take_move(self, robot: int, move: Move) -> None:
        """Take a living robot's move, its first of this step."""
        step = self._world.step
        if not self._running or move.step != step:
            raise ProtocolError("Move", 0, f"for step {move.step}, while step {step} is under way")
        if robot in self._moves:
            raise ProtocolError("Move", 0, f"a second one for step {step}")
        if robot in self._world.cells:
            self._moves[robot] = move

    def _end_step(self) -> None:
        moves, self._moves = self._moves, {}
        explored = sorted(robot for robot, move in moves.items() if move.explored)
        wanted = 1
        if self._world.settings.ends_with_all:
            wanted = len(moves)
        elif explored:
            explored = [robot for robot in self._world.thinnest() if robot in explored]
        if explored and len(explored) >= wanted:
            self._end(EXPLORED, explored[0])
        elif not self._world.cells:
            self._end(ALL_LOST, -1)
        elif all(move.stalled for move in moves.values()):
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
        self._nonsense.clear()
        world = self._world
        for robot in world.doomed():
            world.lose(robot)
            self._tell(robot, End(world.step, "broken down, as the scenario has it", -1))
        senses = world.advance(moves)
        for robot, sense in senses.items():
            self._tell(robot, sense)
        robots = list(world.cells)
        positions = Positions(
            world.step, robots, [world.cells[r][0] for r in robots], [world.cells[r][1] for r in robots]
        )
        self._bus.put(self._keys.control_tx(names.WORLD), pack(positions))
        self._report(self._truth())

    def _fault(self, who: str, what: str) -> None:
        """Report what made no sense; who says too much of it is given up."""
        self._nonsense[who] += 1
        if self._nonsense[who] <= MOST_NONSENSE:
            self._report(Fault(who[:MOST_WORD], clip(what)))
        elif self._nonsense[who] == MOST_NONSENSE + 1 and names.is_robot(who):
            self.give_up_on(names.number(who), BABBLES)

    def _report(self, message: Record) -> None:
        """Tell the laboratory, and the viewer if there is one."""
        payload = pack(message)
        self._bus.put(self._keys.control(names.LAB, names.WORLD), payload)
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
        self._bus.put(self._keys.body(names.robot(robot), names.WORLD), pack(message))
