"""When a robot reports that nothing is left to explore, which may end the run.

If the strategy finds nothing left, the map may be wrong or incomplete. So the robot goes on for a while:

    doubt                                                         what the robot does
    it could not reach some targets                               tries them again
    a person may stand before a frontier                          looks again (`planning.second_look`)
    the map has assumptions, or uncertain walls of noisy lasers   waits for `sure_after` steps
    forwarded entries may be forged                               waits for `VERIFY_STEPS`
    teammates in range lack areas that it has found               waits for `DELIVERY_STEPS` or more
"""

from __future__ import annotations

from dataclasses import replace

from agent.encodings.base import MapEncoding
from agent.encodings.catalog import encoding_class
from agent.mapping.mapper import Mapper
from agent.planning.noisy_grid import NoisyGrid
from agent.planning.path_planner import PathPlanner
from agent.planning.second_look import SecondLook
from agent.replication.base import Replication
from agent.settings import Settings
from agent.strategies.base import Decision, Situation
from agent.strategies.registry import strategy
from protocol.grid import OCCUPIED, Grid

SURE_AFTER = 10
"""Steps for which a map with assumptions must have nothing left to explore before a robot reports that it is done:
by then teammates have sent more of areas that looked insignificant when they first saw them."""

SURE_AFTER_NOISE = 3
"""The same for maps of noisy lasers, where a false wall or a person may close a doorway for some steps. A robot does
not wait if nothing would be left even if all walls were open of which it is not certain."""

SURE_AFTER_NOISE_IN_TEAM = 1
"""The same in a team: a second robot must agree (`worldsim.ending`)."""

SURE_AFTER_LOG = 20
"""Steps for which a robot that replays a log must have nothing to deliver: changes may wait until they are encoded."""

VERIFY_STEPS = 3
"""Steps in which the authors of forged entries, which receive them as well, send digests and true entries."""

DELIVERY_STEPS = 5
"""Most steps for which a robot that has nothing left waits until teammates in range hold the areas that it has found:
its report may end the run, and they would lack them. If updates are long, it waits as long as two of them take."""


def sure_after(settings: Settings) -> int:
    """Return the steps for which a robot must find nothing left to explore before it reports that it is done.

    Twice as many for maps with assumptions on a medium that may lose or delay frames.
    """
    if not strategy(settings.strategy).explores:
        return SURE_AFTER_LOG
    if not encoding_class(settings.encoding.name).infers_cells(settings):
        if settings.laser is None:
            return 0
        return SURE_AFTER_NOISE_IN_TEAM if settings.robots > 1 else SURE_AFTER_NOISE
    return 2 * SURE_AFTER if settings.replication.requires_acks else SURE_AFTER


class Completion:
    """One robot's doubts about decisions after which nothing is left to explore."""

    def __init__(
        self,
        settings: Settings,
        mapper: Mapper,
        noisy_grid: NoisyGrid | None,
        encoding: MapEncoding,
        replication: Replication,
    ) -> None:
        self._mapper = mapper
        self._noisy_grid = noisy_grid
        self._encoding = encoding
        self._replication = replication
        self._verifies = settings.replication.digests
        self._radius_cells = settings.body.radius_cells
        self._sure_after = sure_after(settings)
        self._second_look = None
        if settings.people and not strategy(settings.strategy).returns(settings.options):
            self._second_look = SecondLook(settings)
        self._idle_steps = 0
        """Steps in a row in which nothing was left to explore."""

    def review(self, decision: Decision, situation: Situation) -> Decision:
        """Return the strategy's decision, or one that does not end the run yet."""
        decision = self._try_again(decision)
        self._idle_steps = self._idle_steps + 1 if decision.explored else 0
        return self._look_again(decision, situation)

    def is_certain(self, planning: Grid, situation: Situation) -> bool:
        """Return whether nothing was left for so long that the robot reports it.

        `planning` is the robot's planning grid, uint8 of shape (h, w).
        """
        waiting = self._doubting_steps(planning, situation) + self._verifying_steps()
        return self._idle_steps > waiting + self._delivering_steps(situation)

    def _try_again(self, decision: Decision) -> Decision:
        """Return a decision that does not end the run yet if the robot avoids targets for a while."""
        if not decision.explored or self._noisy_grid is None or not self._noisy_grid.avoided.waits:
            return decision
        return replace(decision, explored=False, status="waiting to try targets again that it did not reach")

    def _look_again(self, decision: Decision, situation: Situation) -> Decision:
        """Return a decision that does not end the run yet if a person may stand before a frontier.

        A robot to which teammates leave no target looks again as well.
        """
        if self._second_look is None:
            return decision
        is_idle = decision.explored or (decision.target is None and not len(decision.path))
        self._second_look.note(situation.grid, is_idle=is_idle)
        way = self._second_look.way(situation.grid, situation.here) if is_idle else None
        if way is None:
            return decision
        return replace(decision, path=way, explored=False, status="looking again at a wall before a frontier")

    def _doubting_steps(self, planning: Grid, situation: Situation) -> int:
        """Return for how many steps it doubts that nothing is left: none if no doubtful wall can hide a frontier."""
        if self._noisy_grid is None or self._sure_after > SURE_AFTER_NOISE:
            return self._sure_after
        doubtful = (self._mapper.states == OCCUPIED) & ~self._mapper.settled()
        grid = self._noisy_grid.clean_optimistic(planning, doubtful)
        left = PathPlanner(grid, radius_cells=self._radius_cells).frontier(*situation.here)
        return self._sure_after if len(left) else 0

    def _verifying_steps(self) -> int:
        """Return for how many further steps it waits for digests, which may show that forwarded entries are forged."""
        return VERIFY_STEPS if self._verifies and self._replication.replica.has_forwarded() else 0

    def _delivering_steps(self, situation: Situation) -> int:
        """Return for how many further steps it waits if teammates in range lack areas that it has found."""
        has_news = bool(situation.peers) and self._encoding.has_news(
            self._mapper.states, delivered=self._replication.delivered()
        )
        return max(DELIVERY_STEPS, 2 * self._encoding.update_steps) if has_news else 0
