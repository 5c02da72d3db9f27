"""Teammates out of range, heard of through those between: a sub-team is all that are connected (Burgard et al., II-D).

With each broadcast a robot passes on where its teammates are and where they are headed, and how many steps ago they
were there (`packets.Passed`). A chain of r robots has r - 2 between its ends, and each costs a step, so what is older
comes from a robot that is connected no more, and is dropped: word of it goes round no longer than that.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from agent.settings import Settings
from agent.strategies.base import Cell, Pose
from protocol.packets import MAX_AGE, Passed, Target


class RelayedState:
    """What one robot has been told of others."""

    def __init__(self, settings: Settings) -> None:
        self._robot = settings.robot
        self._oldest = min(settings.robots - 2, MAX_AGE)
        """Steps after which a robot is not connected any more of which nothing new is heard."""
        self._seen: dict[int, int] = {}
        """The step in which each was where it is said to be."""
        self._told_of: set[int] = set()
        """Those of whom others have told last, not they themselves."""

    def take(self, packet: Passed, step: int) -> bool:
        """Take what has been passed on in a step; whether it is news."""
        seen = step - packet.age
        if (
            packet.robot == self._robot
            or packet.age > self._oldest
            or seen <= self._seen.get(packet.robot, -1)
        ):
            return False
        self._seen[packet.robot] = seen
        self._told_of.add(packet.robot)
        return True

    def connected(self, step: int, peers: Collection[int]) -> tuple[int, ...]:
        """Those out of range that are connected in a step, ascending."""
        fresh = {robot for robot in self._told_of if step - self._seen[robot] <= self._oldest}
        return tuple(sorted(fresh - set(peers)))

    def passed_on(
        self,
        step: int,
        heard: Collection[int],
        peers: Collection[int],
        poses: Mapping[int, Pose],
        targets: Mapping[int, Cell],
    ) -> list[Passed | Target]:
        """What to pass on to `peers` in a step: of the robots `heard` in the step before, and what came of others."""
        near = [robot for robot in heard if robot in poses]
        self._seen |= dict.fromkeys(near, step - 1)
        self._told_of -= set(near)
        said: list[Passed | Target] = []
        for robot in sorted({*near, *self.connected(step, near)}):
            if step - self._seen[robot] <= self._oldest and set(peers) - {robot}:
                said.append(Passed(robot, step - self._seen[robot], *poses[robot][:2]))
                said += [Target(*targets[robot])] if robot in targets else []
        return said
