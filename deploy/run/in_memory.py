"""A run in one process: the same cores and shells as on Zenoh, on the memory bus. For sweeps and tests."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, Protocol

from agent.journal import Journal, journal_name
from agent.process import AgentNode
from agent.robot import Robot
from deploy.record.records import RecorderNode, Records
from deploy.run.garbage import seldom_looking
from deploy.scenario.plan import Plan
from netshaper.process import RelayNode
from protocol import keys as names
from protocol.bus import Bus, BusClosed, Message
from protocol.memory_bus import MemoryHub
from protocol.messages import Change, FaultEvent
from worldsim.process import WorldNode


class Node(Protocol):
    """The interface of all shells."""

    done: bool

    def handle(self, message: Message) -> None:
        """Take one message from the bus."""


Fell = Callable[[str, Exception], object]
"""Called with a robot's name, and with what its code raised."""


class MemoryRun:
    """A run in this process, from its first step to its last.

    Parameters
    ----------
    plan : Plan
    capture : binary file, optional
        Takes the frames (`deploy.record.records`).
    wrap : callable
        May lay something around each participant's end of the bus.
    view : Node, optional
        A viewer.
    wait : callable
        The world's pace.
    fell : callable, optional
        Called when a robot's code raises: that robot is lost then, as a process of its own would be. Without it the
        exception goes to the caller.
    journals : Path, optional
        The folder for what robots need to come back; in memory without it.

    Attributes
    ----------
    agents : list of AgentNode
        The robots' shells, by number; one that comes back has a new one.
    records : Records
        What the laboratory has been told so far.
    """

    def __init__(
        self,
        plan: Plan,
        capture: BinaryIO | None = None,
        *,
        wrap: Callable[[str, Bus], Bus] = lambda _, bus: bus,
        view: Node | None = None,
        wait: Callable[[], object] = lambda: None,
        fell: Fell | None = None,
        journals: Path | None = None,
    ) -> None:
        robots = plan.scenario.robots
        self._minds = [names.robot(number) for number in range(robots)]
        watching = [names.VIEW] if view is not None else []
        self._plan = plan
        self._wrap = wrap
        self._fell = fell
        self._journals = journals
        self._kept: dict[int, BytesIO] = {}
        self._common: dict[str, Any] = {}
        """What robots hold together (`agent.robot.Robot.share`)."""
        self._due: list[int] = []
        """Robots that come back."""
        self._hub = MemoryHub("memory", [names.RELAY, names.WORLD, names.RECORDER, *self._minds, *watching])
        keys = self._hub.keys
        self._buses: dict[str, Bus] = {}
        for name in (names.RELAY, *watching, names.RECORDER, names.WORLD, *self._minds):
            self._buses[name] = wrap(name, self._hub.join(name))
        self._lab = RecorderNode(
            self._buses[names.RECORDER], keys, robots, plan.map.cells.shape, capture, on_fault=_noting(self._due)
        )
        self._world = WorldNode(
            self._buses[names.WORLD],
            keys,
            plan.make_world(),
            plan.scenario.steps,
            1000 * plan.map.resolution,
            wait=wait,
            incarnations=plan.incarnations,
        )
        self._relay = RelayNode(self._buses[names.RELAY], keys, plan.radio, captures=capture is not None)
        self._nodes: dict[str, Node] = {
            names.RELAY: self._relay,
            names.WORLD: self._world,
            names.RECORDER: self._lab,
        }
        self.agents = [self._agent(number) for number in range(robots)]
        self._nodes |= zip(self._minds, self.agents, strict=True)
        if view is not None:
            self._nodes[names.VIEW] = view
        self._lab.configure(plan.robot_settings)

    @property
    def records(self) -> Records:
        """What the laboratory has been told so far."""
        return self._lab.records

    def ask(self, wish: FaultEvent | Change) -> None:
        """Ask for something that the scenario does not have."""
        self._lab.request(wish)

    def steps(self, heed: Callable[[RecorderNode], object] = lambda _: None) -> Iterator[int]:
        """Go on, and yield each step that is over, from 0, the time before the first.

        All has been told of it then, the world has opened the next one, and no robot knows of that.
        `heed` may end the run early (`deploy.run.interrupt`).
        """
        over = -1
        while not self._is_done():
            spoke = False
            heed(self._lab)
            for name in self._hub.in_turn():
                spoke |= self._take_turn(name)
                if name == names.RECORDER:
                    self._end_the_lost()
                    if self._last_step() > over:
                        over = self._last_step()
                        yield over
            while self._due:
                self._come_back(self._due.pop())
            if not spoke and not self._is_done():
                self._give_up_on_the_late()

    def _give_up_on_the_late(self) -> None:
        """All wait for somebody. Nothing more can come, so that who is waited for is given up at once."""
        late = {robot: node for node in (self._relay, self._world) for robot in node.waiting_for()}
        for robot, node in late.items():
            node.give_up_on(robot, "kept the others waiting")
        if not late and self._lab.records.end is not None and not self._lab.done:
            self._lab.finish_without_missing()
        elif not late:
            raise RuntimeError("the run stands still: everyone waits for someone")

    def _end_the_lost(self) -> None:
        """End the robots that the run goes on without, as a launcher ends their processes."""
        for robot in self._lab.records.lost:
            if not self.agents[robot].done:
                self.agents[robot].done = True
                self._buses[self._minds[robot]].close()

    def _take_turn(self, name: str) -> bool:
        """Let a participant take its messages; whether there were any."""
        node, bus = self._nodes[name], self._buses[name]
        spoke = False
        try:
            while (message := _next(bus)) is not None:
                spoke = True
                node.handle(message)
        except Exception as error:
            if self._fell is None or not isinstance(node, AgentNode):
                raise
            self._fell(name, error)
            node.done = True
        if node.done:
            bus.close()
        return spoke

    def _come_back(self, number: int) -> None:
        """Let a robot join anew, with what is in its journal."""
        name = self._minds[number]
        self._buses[name] = self._wrap(name, self._hub.join(name))
        self._nodes[name] = self.agents[number] = self._agent(number)

    def _agent(self, number: int) -> AgentNode:
        bus = self._buses[self._minds[number]]
        return AgentNode(bus, self._hub.keys, number, self._journal(number), self._common)

    def _journal(self, number: int) -> Journal | None:
        """The journal of a robot, in a folder or in memory; None where no robot can come back."""
        if self._plan.incarnations == 1:
            return None
        if self._journals is not None:
            return Journal.open(self._journals / journal_name(number))
        return Journal(self._kept.setdefault(number, BytesIO()))

    def _last_step(self) -> int:
        """The last step that is over: the one before the one that the world has opened, or the end's."""
        records = self._lab.records
        return records.end.step if records.end is not None else records.step - 1

    def _is_done(self) -> bool:
        return all(node.done for node in self._nodes.values())


def run(
    plan: Plan,
    watch: Callable[[Records], object] | None = None,
    capture: BinaryIO | None = None,
    *,
    heed: Callable[[RecorderNode], object] = lambda _: None,
    wrap: Callable[[str, Bus], Bus] = lambda _, bus: bus,
    view: Node | None = None,
    wait: Callable[[], object] = lambda: None,
    fell: Fell | None = None,
    journals: Path | None = None,
    leave: Callable[[list[Robot]], object] = lambda _: None,
) -> Records:
    """Run a plan to its end; as for `MemoryRun`.

    `watch` is called whenever a step has been opened, `leave` with the robots at the end, with all that they hold.
    """
    under_way = MemoryRun(plan, capture, wrap=wrap, view=view, wait=wait, fell=fell, journals=journals)
    opened = 0
    with seldom_looking():
        for _ in under_way.steps(heed):
            if watch is not None and under_way.records.step > opened:
                opened = under_way.records.step
                watch(under_way.records)
    leave([agent.robot for agent in under_way.agents if agent.robot is not None])
    return under_way.records


def _noting(due: list[int]) -> Callable[[FaultEvent], object]:
    """Note who is to come back. It knows no more of the run, which is gone when its last user is."""
    return lambda event: due.append(event.robot) if event.kind == "restart" else None


def _next(bus: Bus) -> Message | None:
    """What waits at an end of the bus, if anything does."""
    try:
        return bus.receive(0)
    except BusClosed:
        return None
