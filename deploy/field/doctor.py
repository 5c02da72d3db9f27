"""Why a robot in the field stands still: checks of its key, its radio, its router, and what its ROS 2 nodes send.

Each check returns its finding, or raises `Trouble`, which says what is wrong and how to fix it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from functools import partial

from agent.radios.team_key import KeyFileError, read_key
from agent.radios.transport import TransportError
from deploy.field.connection import make_body, map_pose
from deploy.field.listener import ENOUGH_MESSAGES, LISTEN_S, Listener, ReceivedTopic
from deploy.field.robot_file import RobotFile, radio_text
from deploy.field.robot_plan import map_frame
from deploy.record.number_texts import counted
from protocol.nanoseconds import SECOND
from protocol.ros2.graph import Graph
from protocol.ros2.interfaces import NAVIGATE_TO_POSE
from protocol.ros2.messages import DISTROS, POSE_STAMPED, Messages
from protocol.ros2.tokens import EndpointToken, Kind
from protocol.transforms import frame_name

LEAST_HZ = 1.0
"""Rate of scans and transforms below which a robot stands still again and again (`dead_man_s`)."""
APART_S = 1.0
"""Seconds between the stamps of scans and transforms from which the clocks of their nodes differ."""
SIMULATED_S = 10 * 365 * 86400
"""Stamps before 1980 are simulated time."""
SHOWN_NODES = 6

DISTRO = "set ros2.distro to that of the robot's nodes"
GRID = "set ros2.map_pose to where SLAM starts in the common frame, or enlarge [grid]"
CLOCKS = (
    "synchronize the clocks of the robot's computers (chrony), and set use_sim_time on all nodes or on none"
)

ONE_ROBOT = (
    "let one node send it; if these are several robots, give each a namespace, or a domain of its own (ROS_DOMAIN_ID), "
    "and set ros2.namespace or ros2.domain"
)

FIXES = {
    "no transforms (tf)": "start SLAM; set ros2.map_frame and ros2.base_frame to the robot's names; if its transforms "
    'are outside of its namespace, set ros2.tf = "/tf" and ros2.tf_static = "/tf_static"',
    "not of the time of the scans": CLOCKS,
    "outside the grid": GRID,
    "tilted": "use a level laser, or correct the robot's description",
    "has jumped": "wait until SLAM has settled, and try again",
    "laser scan:": "let the driver send scans with beams at equal angles",
    "map:": "let SLAM send a valid map",
}
"""What helps against each problem that a body reports, by a part of its text."""


ABSENT = {
    "map": ', or set ros2.map = "" if the robot has none',
    "scan": ', or set ros2.scan = "" if the robot offers only its map',
}
"""What to set if a robot does not offer a topic."""


class Trouble(Exception):  # noqa: N818  a finding, not an error of the program
    """What is wrong, and how to fix it; `fix` is empty if the problem says it already."""

    def __init__(self, problem: str, fix: str = "") -> None:
        super().__init__(problem)
        self.fix = fix


class SkippedError(Exception):
    """A check is impossible; the text says why."""


class RobotDoctor:
    """The checks of one robot, and what its node has received; `close` it at the end."""

    def __init__(self, file: RobotFile) -> None:
        settings = file.settings
        self._file, self._settings, self._names = file, settings, settings.ros2
        self._map_pose = map_pose(self._names)
        self._body = make_body(settings)
        self._listener: Listener | None = None
        self._graph = Graph()

    def checks(self) -> Iterator[tuple[str, Callable[[], str]]]:
        """Return all checks by name, in the order in which they must be made."""
        yield "key", self.key
        yield "radio", self.radio
        yield "start pose", self.start_pose
        yield "router", self.router
        yield "nodes", self.nodes
        names = self._names
        for name in ("tf", "tf_static", "scan", "map"):
            if getattr(names, name):
                yield name, partial(self.topic, name)
        yield "frames", self.frames
        yield "clocks", self.clocks
        yield "goals", self.goals

    def close(self) -> None:
        """Close the node."""
        if self._listener is not None:
            self._listener.node.close()

    # --- checks

    def key(self) -> str:
        """Check the team's key file and its permissions."""
        try:
            read_key(self._file.key)
        except KeyFileError as error:
            raise Trouble(str(error)) from None
        return f"{self._file.key}, which only its owner can read"

    def radio(self) -> str:
        """Check that the interface or the port can be used; only `murmur robot` shows which teammates it receives."""
        try:
            self._settings.radio.check_transport()
        except TransportError as error:
            raise Trouble(str(error)) from None
        return radio_text(self._settings)

    def start_pose(self) -> str:
        """Check that the robot's map frame lies on the team's grid."""
        x, y, degrees = self._names.map_pose
        grid = map_frame(self._settings)
        where = f"({x:g}, {y:g}) m, {degrees:g} degrees"
        if not grid.has(grid.place(self._map_pose)):
            raise Trouble(f"map_pose = {where} is outside of the grid", GRID)
        if self._names.map_pose == (0.0, 0.0, 0.0) and self._settings.robots > 1:
            return f"{where}; right for one robot of the team only, which starts at the origin of the common frame"
        if _looks_like_radians(degrees):
            return f"{where} in the common frame; map_pose is in degrees, but {degrees:g} looks like radians"
        return f"{where} in the common frame"

    def router(self) -> str:
        """Check that a router answers, and listen to the robot's nodes for some seconds."""
        names = self._names
        try:
            self._listener = Listener(names, self._body)
        except ConnectionError:
            raise Trouble(
                f"no Zenoh router answers at {names.router}",
                "start it with: ros2 run rmw_zenoh_cpp rmw_zenohd; or set ros2.router",
            ) from None
        self._listener.listen()
        self._graph = self._listener.node.graph()
        return names.router

    def nodes(self) -> str:
        """Check that nodes are visible in the domain."""
        node = self._connected().node
        found = sorted({each.full_name for each in self._graph.nodes if each != node.token})
        if not found:
            others = node.domains() - {self._names.domain}
            fix = "start the robot's nodes with RMW_IMPLEMENTATION=rmw_zenoh_cpp and this router"
            if others:
                fix = f"nodes are visible in domain {', '.join(map(str, sorted(others)))}: set ros2.domain"
            raise Trouble(f"no node is visible in domain {self._names.domain}", fix)
        shown = ", ".join(found[:SHOWN_NODES]) + (", ..." if len(found) > SHOWN_NODES else "")
        return f"{len(found)} in domain {self._names.domain}: {shown}"

    def topic(self, name: str) -> str:
        """Check that messages arrive on a topic, and how often."""
        listener = self._connected()
        received = listener.received[name]
        if rejected := listener.node.rejected.get(received.topic):
            raise Trouble(f"malformed messages on {received.topic}: {rejected}", DISTRO)
        if not received.arrived:
            if name == "tf_static" and not self._graph.of_topic(received.topic, Kind.PUBLISHER):
                return (
                    f"nothing on {received.topic}; needed only if a frame on the way to the sensor is fixed"
                )
            raise self._missing(name, received)
        if name in ("scan", "tf") and len(received.arrived) >= ENOUGH_MESSAGES and received.rate < LEAST_HZ:
            raise Trouble(
                f"{received.topic} has {received.rate:.1f} messages per second",
                f"send {LEAST_HZ:g} or more per second, or increase dead_man_s",
            )
        if name == "map" and (frame := frame_name(received.frame)) != self._names.map_frame:
            raise Trouble(
                f"{received.topic} is in frame {frame!r}, not {self._names.map_frame!r}",
                f'set ros2.map_frame = "{frame}"',
            )
        publishers = self._fitting(received.topic, Kind.PUBLISHER, received.type_name)
        if name in ("scan", "map") and len(publishers) > 1:
            senders = ", ".join(sorted(each.node.full_name for each in publishers))
            raise Trouble(f"{len(publishers)} publishers send {received.topic}: {senders}", ONE_ROBOT)
        rate = f", {received.rate:.1f} per second" if name in ("scan", "tf") and received.rate else ""
        return f"{counted(len(received.arrived), 'message')} on {received.topic}{rate}"

    def frames(self) -> str:
        """Check that transforms connect the sensor to the map frame, and that the robot is on the grid."""
        self._connected()
        body = self._body
        where = body.base(self._names.base_frame)
        if body.problem or where is None:
            problem = body.problem or "no pose is known"
            fixes = [fix for part, fix in FIXES.items() if part in problem]
            raise Trouble(problem, fixes[0] if fixes else "see the topics above")
        x, y, yaw = self._map_pose.then(where)
        return f"the robot is at ({x:.2f}, {y:.2f}) m, {math.degrees(yaw):.0f} degrees in the common frame"

    def clocks(self) -> str:
        """Check that stamps advance, and that those of scans and transforms are of one clock."""
        listener = self._connected()
        received = listener.received["scan" if self._names.scan else "tf"]
        if len(received.stamps) < 2:
            raise SkippedError(f"too few messages on {received.topic}")
        elapsed = (received.stamps[-1] - received.stamps[0]) / SECOND
        real = received.arrived[-1] - received.arrived[0]
        if elapsed <= 0.1 * real:
            raise Trouble(
                f"stamps of {received.topic} advance by {elapsed:.2f} s in {real:.2f} s",
                "let the simulation run, or the driver set the stamps of its messages",
            )
        transforms = listener.received["tf"].stamps
        apart = (received.stamps[-1] - max(transforms)) / SECOND if transforms else 0.0
        order = "after" if apart > 0 else "before"
        if abs(apart) > APART_S:
            raise Trouble(f"stamps of {received.topic} are {abs(apart):.1f} s {order} those of tf", CLOCKS)
        if received.stamps[-1] < SIMULATED_S * SECOND:
            return f"simulated time, {elapsed / real:.2f} s per second"
        age = time.time() - received.stamps[-1] / SECOND
        return (
            f"stamps of {received.topic} are {age:.1f} s old by the clock of this computer, which may differ"
        )

    def goals(self) -> str:
        """Check that something takes goals."""
        names = self._names
        service = f"{names.navigate_to_pose}/_action/send_goal"
        if names.navigate_to_pose and (
            servers := self._fitting(service, Kind.SERVER, f"{NAVIGATE_TO_POSE}_SendGoal")
        ):
            return f"over the action {names.navigate_to_pose}, to {servers[0].node.full_name}"
        if names.goal_pose and (
            subscriptions := self._fitting(names.goal_pose, Kind.SUBSCRIPTION, POSE_STAMPED)
        ):
            return f"over {names.goal_pose}, to {subscriptions[0].node.full_name}"
        tried = " or ".join(each for each in (names.navigate_to_pose, names.goal_pose) if each)
        raise Trouble(
            f"no node takes goals over {tried}", "start nav2, or set ros2.navigate_to_pose or ros2.goal_pose"
        )

    def _missing(self, name: str, received: ReceivedTopic) -> Trouble:
        """Return why no message arrives on a topic, as far as the graph shows it."""
        publishers = self._graph.of_topic(received.topic, Kind.PUBLISHER)
        others = [each.data_key.type for each in publishers if each.data_key.type != received.type_name]
        if others:
            problem = f"{received.topic} has messages of type {others[0]}, not {received.type_name}"
            return Trouble(problem, f"set ros2.{name} to another topic")
        fitting = self._fitting(received.topic, Kind.PUBLISHER, received.type_name)
        if others := [each.data_key.type_hash for each in publishers if each not in fitting]:
            found = others[0]
            right = [each for each in DISTROS if Messages(each).type_hash(received.type_name) == found]
            problem = (
                f"{received.topic} has another definition of {received.type_name} than {self._names.distro}"
            )
            return Trouble(problem, f'set ros2.distro = "{right[0]}"' if right else DISTRO)
        if publishers:
            sender = publishers[0].node.full_name
            problem = f"{sender} publishes {received.topic}, but no message has arrived in {LISTEN_S:g} s"
            return Trouble(problem, "check that this node works, for example that its sensor is switched on")
        all_topics = self._graph.names(Kind.PUBLISHER).items()
        similar = [topic for topic, types in all_topics if received.type_name in types]
        if similar:
            fix = f"set ros2.{name} to one of: {', '.join(similar)}{self._other_namespaces(name, similar)}"
            return Trouble(f"nothing publishes {received.topic}", fix)
        return Trouble(
            f"nothing publishes {received.topic}", f"start the node that publishes it{ABSENT.get(name, '')}"
        )

    def _other_namespaces(self, name: str, topics: list[str]) -> str:
        """Return advice if topics have the right name in other namespaces; empty if none has."""
        relative = f"/{getattr(self._names, name)}"
        found = sorted(topic.removesuffix(relative)[1:] for topic in topics if topic.endswith(relative))
        spaces = " or ".join(f'"{space}"' for space in found)
        return f"; or, if all topics are missing, set ros2.namespace = {spaces}" if found else ""

    def _fitting(self, name: str, kind: Kind, type_name: str) -> list[EndpointToken]:
        """Return the endpoints of a topic or service that have this distribution's definition of its type."""
        listener = self._connected()
        type_hash = listener.node.messages.type_hash(type_name)
        found = self._graph.of_topic(listener.qualified(name), kind)
        return [each for each in found if each.data_key.type_hash == type_hash]

    def _connected(self) -> Listener:
        if self._listener is None:
            raise SkippedError("no router answers")
        return self._listener


def _looks_like_radians(angle: float) -> bool:
    """Return whether an angle is a multiple of an eighth of a turn in radians, rounded to two digits or more."""
    eighths = round(angle / (math.pi / 4))
    return eighths != 0 and abs(angle - eighths * math.pi / 4) <= 0.006 and abs(angle) < 7
