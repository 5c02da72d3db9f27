"""Runs the simulated robots by the wall clock: their nodes, and a router for them unless there is one."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass

import zenoh

from deploy.run.interrupt import Interrupt
from deploy.scenario.plan import Plan
from deploy.serve.ros_robot import ALL, Offers, RosRobot
from deploy.serve.swarm import Swarm
from protocol.errors import shown, there_are
from protocol.nanoseconds import SECOND
from protocol.ros2 import messages as names
from protocol.ros2.names import check_domain
from protocol.ros2.node import Ros2Node
from protocol.ros2.qos import Qos, Reliability
from protocol.ros2.session import ROUTER, open_router

CLOCK_QOS = Qos(Reliability.BEST_EFFORT, depth=1)
NODE = "murmur_simulator"


@dataclass(frozen=True)
class ServeSettings:
    """How robots appear in ROS; ValueError if the domain or the distribution is wrong."""

    namespaces: tuple[str, ...]
    """The namespace of each robot, without a slash in front."""
    domain: int = 0
    distro: str = "jazzy"
    router: str = ROUTER
    own_router: bool = True
    """Whether to start a router at this address."""
    sim_time: bool = False
    """Whether stamps are simulated time, as on ``/clock``; else they are the time of this host."""
    rate: float = 10.0
    """Steps of the simulation per second."""
    sees_robots: bool = False
    """Whether lasers measure the distance to other robots."""
    offers: Offers = ALL
    """What robots offer besides their driver."""

    def __post_init__(self) -> None:
        check_domain(self.domain)
        if self.distro not in names.DISTROS:
            raise ValueError(f"distro = {shown(self.distro)}: {there_are(names.DISTROS, self.distro)}")


def serve(
    plan: Plan, settings: ServeSettings, ready: Callable[[Swarm], object], warn: Callable[[str], object]
) -> Swarm:
    """Serve robots until Ctrl-C; return them. `ready` is called when all nodes exist, `warn` for ignored messages.

    Further signals do not interrupt the end: nodes that are not closed would keep the process alive.

    ConnectionError without a router; ValueError if its address is malformed, or in use, or if other nodes have the
    names of the robots' nodes.
    """
    began_ns = time.time_ns() - time.monotonic_ns()

    def clock_ns() -> int:
        """Return the time since 1970; it never jumps, even if the user sets the clock of this host."""
        return began_ns + time.monotonic_ns()

    swarm = Swarm(plan, clock_ns(), rate=settings.rate, sees_robots=settings.sees_robots)
    interrupt = Interrupt()
    with interrupt.caught(), contextlib.ExitStack() as stack:
        if settings.own_router:
            stack.callback(_router(settings.router).close)
        robots: list[RosRobot] = []
        for number, robot in enumerate(swarm.robots):
            node = stack.enter_context(_node(settings, settings.namespaces[number]))
            least_m = plan.scenario.body_of(number).laser.min_range_m
            if not robots:
                _check_names(node, settings)
            robots.append(RosRobot(node, robot, least_m, warn, clock_ns(), settings.offers))
        clock = None
        if settings.sim_time:
            node = stack.enter_context(_node(settings, "/"))
            clock = node.publisher("/clock", names.CLOCK, CLOCK_QOS), node.messages
        ready(swarm)
        while not interrupt.came:
            now_ns = clock_ns()
            for each in robots:
                each.receive(now_ns)
            if swarm.advance(now_ns):
                stamp_ns = swarm.time_ns if settings.sim_time else swarm.now_ns
                if clock is not None:
                    publisher, messages = clock
                    publisher.publish(messages[names.CLOCK](clock=messages.time(stamp_ns)), now_ns)
                for each in robots:
                    each.publish(stamp_ns, now_ns)
            time.sleep(max(0, swarm.next_ns - clock_ns()) / SECOND)
    return swarm


def _router(address: str) -> zenoh.Session:
    """Open a router; ValueError if it cannot listen there."""
    try:
        return open_router(address)
    except ConnectionError as error:
        raise ValueError(
            f"{error}; name another one with --listen, or --router {address} if a Zenoh router runs there"
        ) from None


def _check_names(first: Ros2Node, settings: ServeSettings) -> None:
    """Raise ValueError if nodes other than the `first` have names of this process: both would share all topics."""
    ours = {f"/{each}/{NODE}" for each in settings.namespaces}
    others = sorted({node.full_name for node in first.graph().nodes if node != first.token} & ours)
    if others:
        raise ValueError(
            f"names = {','.join(settings.namespaces)}: in domain {settings.domain}, {', '.join(others)} exists "
            "already, from another murmur serve-ros2; choose other --names, another --domain, or end that process"
        )


def _node(settings: ServeSettings, namespace: str) -> Ros2Node:
    return Ros2Node(NODE, namespace, settings.domain, distro=settings.distro, router=settings.router)
