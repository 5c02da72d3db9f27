"""States of teammates out of range, relayed by the robots between (Burgard et al. 2005, section II-D).

With each broadcast a robot forwards the poses and targets of its teammates and the age of this state in steps
(`packets.Passed`). In a chain of r robots a state takes one step for each of at most r - 2 hops. An older state comes
from a robot that is no longer connected, so robots drop it; this also ends its circulation.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from agent.settings import Settings
from agent.strategies.base import Cell, Pose
from protocol.packets import MAX_AGE, Passed, Target


class RelayedState:
    """The relayed states that one robot has received."""

    def __init__(self, settings: Settings) -> None:
        self._robot = settings.robot
        self._oldest = min(settings.robots - 2, MAX_AGE)
        """Age in steps up to which a state shows that its robot is connected."""
        self._seen: dict[int, int] = {}
        """The step of each robot's last known state."""
        self._relayed: set[int] = set()
        """Robots whose last state was relayed, not received from the robot itself."""

    def take(self, packet: Passed, step: int) -> bool:
        """Take a relayed state that arrived in a step; return whether it is newer than the known one."""
        seen = step - packet.age
        if (
            packet.robot == self._robot
            or packet.age > self._oldest
            or seen <= self._seen.get(packet.robot, -1)
        ):
            return False
        self._seen[packet.robot] = seen
        self._relayed.add(packet.robot)
        return True

    def connected(self, step: int, peers: Collection[int]) -> tuple[int, ...]:
        """Return the robots out of range that are connected in a step, ascending."""
        fresh = {robot for robot in self._relayed if step - self._seen[robot] <= self._oldest}
        return tuple(sorted(fresh - set(peers)))

    def forward(
        self,
        step: int,
        senders: Collection[int],
        peers: Collection[int],
        poses: Mapping[int, Pose],
        targets: Mapping[int, Cell],
    ) -> list[Passed | Target]:
        """Return the states to forward to `peers`: of the `senders` of the step before, and relayed ones."""
        near = [robot for robot in senders if robot in poses]
        self._seen |= dict.fromkeys(near, step - 1)
        self._relayed -= set(near)
        states: list[Passed | Target] = []
        for robot in sorted({*near, *self.connected(step, near)}):
            if step - self._seen[robot] <= self._oldest and set(peers) - {robot}:
                states.append(Passed(robot, step - self._seen[robot], *poses[robot][:2]))
                states += [Target(*targets[robot])] if robot in targets else []
        return states
