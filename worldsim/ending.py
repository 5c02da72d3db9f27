"""When a run ends: enough robots report that they are done, no robot makes progress, or a limit is reached."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from protocol.messages import End, Move
from worldsim.base import BaseWorld

OUT_OF_STEPS, ALL_LOST = "out of steps", "all robots are lost"

LONE_REPORT_STEPS = 3
"""Steps after which the report of one robot ends a run with real sensors, if no teammate agrees."""


class Ending:
    """The rule for the end of a run in `world`, which has at most `steps` steps."""

    def __init__(self, world: BaseWorld, steps: int) -> None:
        self.stop_reason = ""
        """Why the recorder asked for the run to end after this step; empty if it did not."""
        self._world = world
        self._steps = steps
        self._report_steps: dict[int, int] = {}
        """For how many steps in a row each robot has reported `explored`."""
        self._refuted: set[int] = set()
        """Robots that have reported `explored` too early."""
        self._early: list[tuple[int, str]] = []

    def check(self, moves: Mapping[int, Move], robots: int, *, deserted: bool) -> End | None:
        """Return the end of the run if a step with these moves ends it, else None.

        `robots`: number of robots that could have moved; by the wall clock, some may have missed the step. `deserted`:
        no robot takes part in the run, and none will.
        """
        world = self._world
        may_end = world.may_end()
        explored = sorted(robot for robot, move in moves.items() if move.explored and may_end)
        self._report_steps = {robot: self._report_steps.get(robot, 0) + 1 for robot in explored}
        if finished := self._finished(explored, robots):
            return self._end(world.finished, finished[0])
        if deserted:
            return self._end(ALL_LOST)
        if may_end and len(moves) >= robots and world.is_stalled(moves):
            return self._end(world.stalled)
        if self.stop_reason:
            return self._end(self.stop_reason)
        return self._end(OUT_OF_STEPS) if world.step >= self._steps else None

    def take_early_reports(self) -> list[tuple[int, str]]:
        """Return the robots that have reported `explored` too early since the last call, each with the reason."""
        early, self._early = self._early, []
        return early

    def _end(self, reason: str, first: int = -1) -> End:
        return End(self._world.step, reason, first)

    def _finished(self, explored: Sequence[int], robots: int) -> Sequence[int]:
        """Return those of the robots that report `explored` which end the run, the first one first."""
        if self._world.settings.ends_with_all:
            first = sorted(explored, key=self._report_steps.__getitem__, reverse=True)
            return first if len(explored) >= robots else []
        return self._confirmed(explored) if self._suffice(explored, robots) else []

    def _suffice(self, explored: Sequence[int], robots: int) -> bool:
        """Return whether enough of the robots report `explored` in this step.

        Usually one is enough. With sensors that have errors, false walls may enclose a robot: then two must agree, or
        one must report it for `LONE_REPORT_STEPS` steps, in which teammates may open a way for it.
        """
        if self._world.settings.sensors is None:
            return len(explored) > 0
        longest = max(self._report_steps.values(), default=0)
        return len(explored) >= min(robots, 2) or longest >= LONE_REPORT_STEPS

    def _confirmed(self, explored: Sequence[int]) -> list[int]:
        """Return the robots whose report `explored` ends the run; note the others as early.

        Only robots of the smallest radius can know that all is explored. The team must have seen enough for a report,
        and everything if the robot has reported too early before, unless all of these robots agree.
        """
        smallest = self._world.smallest_robots()
        reporting = [robot for robot in smallest if robot in explored]
        least = self._world.settings.min_coverage
        seen = {robot: self._world.share_seen(robot) for robot in reporting}
        confirmed = [robot for robot in reporting if seen[robot] >= (1 if robot in self._refuted else least)]
        if confirmed or len(reporting) == len(smallest):
            return sorted(confirmed or reporting, key=self._refuted.__contains__)
        for robot in sorted(set(reporting) - self._refuted):
            share = f"{100 * seen[robot]:.1f} % of the cells that it can reach"
            self._early.append((robot, f"robot {robot} reported 'explored' when the team had seen {share}"))
        self._refuted.update(reporting)
        return []
