"""The step barrier: the moves of a step, which ends by a clock (`worldsim.clock`), and the beginning of the next one.

Restarts that a fault requests hold the next step until the robots have rejoined (`worldsim.restarts`).
"""

from __future__ import annotations

from collections.abc import Mapping

from protocol.errors import ProtocolError
from protocol.messages import Move
from worldsim.base import BaseWorld
from worldsim.clock import StepClock
from worldsim.restarts import Restarts


class Barrier:
    """The moves of the current step, and the decision when it ends and the next one begins."""

    def __init__(self, world: BaseWorld, restarts: Restarts, clock: StepClock) -> None:
        self.restarts = restarts
        self.clock = clock
        self.late: list[int] = []
        """Robots that took part in the last step and did not move in time."""
        self.running = False
        """Whether a step has begun, and the run has not ended."""
        self.medium_closed = False
        """Whether the relay has closed the medium of this step; robots move only then."""
        self._world = world
        self._moves: dict[int, Move] = {}
        """The moves received in this step, by robot."""
        self._held_moves: dict[int, Move] = {}
        """The moves of the last step, until the next one begins; restarts may hold it."""

    @property
    def phase(self) -> tuple[object, ...]:
        """The state of the barrier: it changes whenever the run makes progress."""
        return self._world.step, self.medium_closed, len(self.restarts.awaited)

    def waiting_for(self) -> list[int]:
        """Return the robots that the next step waits for: for their return, or for their moves."""
        if self.restarts.awaited:
            return sorted(self.restarts.awaited - self.restarts.rejoined)
        waits = self.running and self.medium_closed and self.clock.waits
        return [robot for robot in self._world.active_robots() if robot not in self._moves] if waits else []

    def take_move(self, robot: int, move: Move) -> None:
        """Accept the move of an active robot, its first of this step; ProtocolError if it is not.

        Late moves have no effect, nor have those of a robot that has been removed meanwhile.
        """
        step = self._world.step
        if self.clock.is_late(robot, move.step) or robot not in self._world.cells:
            return
        if not self.running or move.step != step:
            raise ProtocolError("Move", 0, f"for step {move.step}, while step {step} is under way")
        if robot in self._moves:
            raise ProtocolError("Move", 0, f"a second one for step {step}")
        if self._world.is_active(robot):
            self._moves[robot] = move

    def step_is_over(self) -> bool:
        """Return whether a step is under way that ends now."""
        if not self.running or self.restarts.awaited or not self.medium_closed:
            return False
        return self.clock.is_over(len(self._moves), self._world.active_count)

    def deadline(self, now_ns: int) -> int | None:
        """Return the time at which this step ends, in nanoseconds; None: it does not end by the time."""
        if not self.running or self.restarts.awaited:
            return None
        due = self.clock.deadline(now_ns)
        return due if self.medium_closed else None

    def end_step(self) -> Mapping[int, Move]:
        """End the step and return its moves; `late` names the robots that missed it."""
        moves, self._moves = self._moves, {}
        self.late = [robot for robot in self._world.active_robots() if robot not in moves]
        self.clock.end(self._world.step, moves, self.late)
        return moves

    def is_deserted(self) -> bool:
        """Return whether no robot takes part in the run, and none will, by the schedule or after a restart."""
        return self._world.is_deserted() and not self.restarts.rejoined and not self.restarts.recovering

    def hold(self, moves: Mapping[int, Move]) -> None:
        """Keep the moves of the last step until the next one begins, which restarts may hold."""
        self.medium_closed = False
        self._held_moves = dict(moves)
        if self._world.is_deserted():
            self.restarts.awaited |= self.restarts.recovering

    def begin_step(self) -> Mapping[int, Move]:
        """Put the robots that have rejoined back into the world, and return the moves of the last step."""
        for robot in self.restarts.take_rejoined():
            self._world.restore(robot)
        absent = self.clock.begin(self._world.step + 1)
        self._world.absent = set(self._world.present_robots()).intersection(absent)
        moves, self._held_moves = self._held_moves, {}
        return moves

    def remove(self, robot: int) -> None:
        """Remove a robot from the world, and its moves."""
        self._world.remove(robot)
        self.clock.forget(robot)
        self._moves.pop(robot, None)
        self._held_moves.pop(robot, None)
