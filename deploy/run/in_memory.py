"""A run in one process: the same cores and shells as on Zenoh, on the memory bus. For sweeps and tests."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Protocol

from agent.journal import Journal, journal_name
from agent.process import AgentNode
from agent.robot import Robot
from deploy.record.records import LabNode, Records
from deploy.scenario.plan import Plan
from netshaper.process import RelayNode
from protocol import keys as names
from protocol.bus import Bus, BusClosed, Message
from protocol.memory_bus import MemoryHub
from protocol.messages import Strike
from worldsim.process import WorldNode


class Node(Protocol):
    """The interface of all shells."""

    done: bool

    def handle(self, message: Message) -> None:
        """Take one message from the bus."""


def run(
    plan: Plan,
    watch: Callable[[Records], object] | None = None,
    capture: BinaryIO | None = None,
    *,
    heed: Callable[[LabNode], object] = lambda _: None,
    wrap: Callable[[str, Bus], Bus] = lambda _, bus: bus,
    view: Node | None = None,
    wait: Callable[[], object] = lambda: None,
    journals: Path | None = None,
    leave: Callable[[list[Robot]], object] = lambda _: None,
    inspect: Callable[[int, Robot], object] | None = None,
) -> Records:
    """Run a plan to its end.

    `watch` is called once a step, `capture` takes the frames (`deploy.record.records`), `heed` may end the run early
    (`deploy.run.interrupt`), `wrap` may lay something around each participant's end of the bus; `view` is a viewer,
    `wait` the world's pace; `journals` is the folder for what robots need to come back, in memory without it; `leave`
    is given the robots at the end, with all that they hold; `inspect` is called with the step and each robot that has
    had its turn.
    """
    robots = plan.scenario.robots
    minds = [names.robot(number) for number in range(robots)]
    watching = [names.VIEW] if view is not None else []
    hub = MemoryHub("memory", [names.RELAY, names.WORLD, names.LAB, *minds, *watching])
    keys = hub.keys
    buses: dict[str, Bus] = {}
    for name in (names.RELAY, *watching, names.LAB, names.WORLD, *minds):
        buses[name] = wrap(name, hub.join(name))
    due: list[int] = []

    def obey(strike: Strike) -> None:
        if strike.kind == "restart":
            due.append(strike.robot)

    lab = LabNode(buses[names.LAB], keys, robots, plan.map.cells.shape, capture, obey=obey)
    world = WorldNode(
        buses[names.WORLD],
        keys,
        plan.make_world(),
        plan.minds,
        plan.scenario.steps,
        1000 * plan.map.resolution,
        wait=wait,
    )
    nodes: dict[str, Node] = {
        names.RELAY: RelayNode(buses[names.RELAY], keys, plan.radio),
        names.WORLD: world,
        names.LAB: lab,
    }
    kept: dict[int, BytesIO] = {}

    def agent(number: int) -> AgentNode:
        return AgentNode(buses[minds[number]], keys, number, _journal(plan, number, journals, kept))

    agents = [agent(number) for number in range(robots)]
    nodes |= zip(minds, agents, strict=True)
    if view is not None:
        nodes[names.VIEW] = view
    step = 0
    while not all(node.done for node in nodes.values()):
        spoke = False
        heed(lab)
        for name in hub.in_turn():
            node, bus = nodes[name], buses[name]
            for message in _waiting(bus):
                node.handle(message)
                spoke = True
            if inspect is not None and isinstance(node, AgentNode) and node.robot is not None:
                inspect(lab.records.step, node.robot)
            if node.done:
                bus.close()
        while due:
            number = due.pop()
            name = minds[number]
            buses[name] = wrap(name, hub.join(name))
            nodes[name] = agents[number] = agent(number)
        if not spoke and not all(node.done for node in nodes.values()):
            raise RuntimeError("the run stands still: everyone waits for someone")
        if watch is not None and lab.records.step > step:
            step = lab.records.step
            watch(lab.records)
    leave([agent.robot for agent in agents if agent.robot is not None])
    return lab.records


def _journal(plan: Plan, number: int, folder: Path | None, kept: dict[int, BytesIO]) -> Journal | None:
    """The journal of a robot, in a folder or in memory; None where no robot can come back."""
    if plan.lives == 1:
        return None
    if folder is not None:
        return Journal.open(folder / journal_name(number))
    return Journal(kept.setdefault(number, BytesIO()))


def _waiting(bus: Bus) -> Iterator[Message]:
    """What waits at an end of the bus, what comes meanwhile included."""
    while True:
        try:
            message = bus.receive(0)
        except BusClosed:
            return
        if message is None:
            return
        yield message
