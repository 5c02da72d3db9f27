"""A run in one process: the same cores and shells as on Zenoh, on the memory bus. For sweeps and tests."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import BinaryIO, Protocol

from agent.process import AgentNode
from deploy.record.records import LabNode, Records
from deploy.scenario.plan import Plan
from netshaper.process import RelayNode
from protocol import keys as names
from protocol.bus import Bus, BusClosed, Message
from protocol.memory_bus import MemoryHub
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
) -> Records:
    """Run a plan to its end.

    `watch` is called once a step, `capture` takes the frames (`deploy.record.records`), `heed` may end the run early
    (`deploy.run.interrupt`), `wrap` may lay something around each participant's end of the bus; `view` is a viewer,
    `wait` the world's pace.
    """
    robots = plan.scenario.robots
    minds = [names.robot(number) for number in range(robots)]
    watching = [names.VIEW] if view is not None else []
    hub = MemoryHub("memory", [names.RELAY, names.WORLD, names.LAB, *minds, *watching])
    keys = hub.keys
    buses: dict[str, Bus] = {}
    for name in (names.RELAY, *watching, names.LAB, names.WORLD, *minds):
        buses[name] = wrap(name, hub.join(name))
    lab = LabNode(buses[names.LAB], keys, robots, plan.map.cells.shape, capture)
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
    for number, name in enumerate(minds):
        nodes[name] = AgentNode(buses[name], keys, number)
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
            if node.done:
                bus.close()
        if not spoke and not all(node.done for node in nodes.values()):
            raise RuntimeError("the run stands still: everyone waits for someone")
        if watch is not None and lab.records.step > step:
            step = lab.records.step
            watch(lab.records)
    return lab.records


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
