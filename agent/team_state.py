"""A robot's beliefs about its teammates: poses, targets, homes and distances traveled.

They come from broadcasts of poses and targets (`protocol.packets`), from scan updates that contain the author's pose,
and from what teammates relay of robots out of range (Burgard et al. 2005, section II-D).

For this, a robot forwards with each broadcast the poses and targets of its teammates and the age of this state in steps
(`packets.Passed`). In a chain of r robots a state takes one step for each of at most r - 2 hops. An older state comes
from a robot that is no longer connected, so robots drop it; this also ends its circulation.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from agent.settings import Settings
from agent.strategies.base import Situation, TeammatePose
from protocol import packets
from protocol.grid import Cell, Grid
from protocol.messages import Sense

PLACED = packets.Pose, packets.Target, packets.Passed
"""Packets that name a cell."""


class TeamState:
    """What one robot believes of itself and its teammates, by robot number."""

    def __init__(self, settings: Settings) -> None:
        self.step = 0
        self.in_range: tuple[int, ...] = ()
        """Teammates in radio range."""
        self.relayed = RelayedState(settings)
        self.poses: dict[int, TeammatePose] = {}
        """The last known pose of each teammate."""
        self.targets: dict[int, Cell] = {}
        """The target of each teammate, as of the last decision."""
        self._robot, self._robots = settings.robot, settings.robots
        self._width, self._height = settings.width, settings.height
        self._home = settings.home
        self._homes: dict[int, Cell] = {}
        self._new_targets: dict[int, Cell] = {}
        self._target_steps: dict[int, int] = {}
        """The step in which each target was received."""
        self._pose_steps: dict[int, int] = {}
        """The step in which each teammate last broadcast its pose."""
        self._moved: dict[int, int] = {}
        """The step in which each teammate was first known to be at another cell than before."""
        self._traveled: dict[int, float] = {}
        self._here: Cell | None = None
        self._lengths = [0] * 6
        """Entries of each table when it was last sorted."""

    def perceive(self, sense: Sense) -> None:
        """Note this robot's own position at the beginning of a step."""
        here = sense.x, sense.y
        if self._here is None:
            self._homes[self._robot] = self._home or here
        else:
            self._travel(self._robot, self._here, here)
        self.step, self._here = sense.step, here

    def receive_broadcast(self, peer: int, received: Sequence[packets.AnyPacket]) -> list[str]:
        """Note the poses and targets in a teammate's broadcast; return what is wrong with it."""
        errors = []
        subject: int | None = peer
        """The robot that the next target belongs to; None: it is not needed."""
        for packet in received:
            if not isinstance(packet, PLACED) or packet.x >= self._width or packet.y >= self._height:
                errors.append(f"{packet} is no target or pose on a {self._width} x {self._height} grid")
            elif isinstance(packet, packets.Pose):
                self._pose_steps[peer] = self.step
                self._note_pose(peer, TeammatePose(packet.x, packet.y, bool(packet.leads)))
            elif isinstance(packet, packets.Target):
                target = packet.x, packet.y
                if subject == peer or (subject is not None and target != self.targets.get(subject)):
                    self._new_targets[subject] = target
            else:
                subject = None
                if packet.robot >= self._robots:
                    errors.append(f"{packet} is no robot of {self._robots}")
                elif packet.robot not in self.in_range and self.relayed.take(packet, self.step):
                    subject = packet.robot
                    self._note_pose(subject, TeammatePose(packet.x, packet.y, leads=False))
        return errors

    def broadcast_pose(self, peer: int) -> TeammatePose | None:
        """Return the pose that a teammate broadcast in this step, if it did."""
        return self.poses[peer] if self._pose_steps.get(peer) == self.step else None

    def infer_pose(self, peer: int, cell: Cell | None) -> None:
        """Note the cell of a teammate's last scan, unless it broadcast its pose in this step, or never did."""
        before = self.poses.get(peer)
        if cell is None or before is None or before[:2] == cell:
            return
        if self._pose_steps[peer] < self.step:
            self._note_pose(peer, TeammatePose(*cell, before.leads))

    def situation(self, sense: Sense, grid: Grid, *, log_entries: int, backlog: int) -> Situation:
        """Return what the strategy decides on, and take over the targets that are new."""
        new_targets, self._new_targets = self._new_targets, {}
        self.targets |= new_targets
        self._target_steps |= dict.fromkeys(new_targets, sense.step)
        self._sort_tables()
        return Situation(
            step=sense.step,
            grid=grid,
            x=sense.x,
            y=sense.y,
            offset=(sense.offset_x, sense.offset_y),
            heading=sense.heading,
            blocked=sense.blocked,
            homes=self._homes.copy(),
            home=self._homes[self._robot],
            peers=self.in_range,
            connected=self.relayed.connected(sense.step, self.in_range),
            poses=self.poses.copy(),
            last_moved=self._moved.copy(),
            traveled=self._traveled.copy(),
            targets=self.targets.copy(),
            target_steps=self._target_steps.copy(),
            new_targets=new_targets,
            log_entries=log_entries,
            backlog=backlog,
        )

    def _sort_tables(self) -> None:
        """Put tables that have another robot than the last time into ascending order of robot numbers."""
        tables: tuple[dict[int, Any], ...] = (
            self._homes, self.poses, self._moved, self._traveled, self.targets, self._target_steps,
        )  # fmt: skip
        for number, table in enumerate(tables):
            if len(table) != self._lengths[number]:
                self._lengths[number] = len(table)
                ascending = sorted(table.items())
                table.clear()
                table.update(ascending)

    def _note_pose(self, peer: int, pose: TeammatePose) -> None:
        before = self.poses.get(peer)
        self.poses[peer] = pose
        if before is None:
            self._homes.setdefault(peer, pose[:2])
            self._moved[peer] = self.step
        elif self._travel(peer, before[:2], pose[:2]):
            self._moved[peer] = self.step

    def _travel(self, robot: int, start: Cell, end: Cell) -> float:
        """Add the way between two cells to the distance that a robot has traveled; return its length."""
        length = math.hypot(end[0] - start[0], end[1] - start[1])
        self._traveled[robot] = self._traveled.get(robot, 0.0) + length
        return length


class RelayedState:
    """The relayed states that one robot has received."""

    def __init__(self, settings: Settings) -> None:
        self._robot = settings.robot
        self._oldest = min(settings.robots - 2, packets.MAX_AGE)
        """Age in steps up to which a state shows that its robot is connected."""
        self._seen: dict[int, int] = {}
        """The step of each robot's last known state."""
        self._relayed: set[int] = set()
        """Robots whose last state was relayed, not received from the robot itself."""

    def take(self, packet: packets.Passed, step: int) -> bool:
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
        poses: Mapping[int, TeammatePose],
        targets: Mapping[int, Cell],
    ) -> list[packets.Passed | packets.Target]:
        """Return the states to forward to `peers`: of the `senders` of the step before, and relayed ones."""
        near = [robot for robot in senders if robot in poses]
        self._seen |= dict.fromkeys(near, step - 1)
        self._relayed -= set(near)
        states: list[packets.Passed | packets.Target] = []
        for robot in sorted({*near, *self.connected(step, near)}):
            if step - self._seen[robot] <= self._oldest and set(peers) - {robot}:
                states.append(packets.Passed(robot, step - self._seen[robot], *poses[robot][:2]))
                states += [packets.Target(*targets[robot])] if robot in targets else []
        return states
