"""A run in one process: the participants of a Zenoh run on the memory bus. For sweeps and tests."""

from __future__ import annotations

import gc
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import numpy as np

from agent.journal import Journal, journal_name
from agent.process import AgentNode
from deploy.record.map_quality import FULL_SHARE, knows_all
from deploy.record.records import RecorderNode, Records
from deploy.scenario.errors import ScenarioError
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import Scenario
from netshaper.phase_clock import RecordedPhases
from netshaper.process import RelayNode
from protocol import keys as names
from protocol.bus import Bus, Message
from protocol.memory_bus import MemoryHub
from protocol.messages import Change, FaultEvent, Missed
from worldsim.clock import RecordedClock
from worldsim.process import WorldNode

GARBAGE = 100_000
"""New Python objects after which the garbage collector runs."""


class Node(Protocol):
    """The interface of all participants."""

    done: bool

    def handle(self, message: Message) -> None:
        """Process one message from the bus."""


OnCrash = Callable[[str, Exception], object]
"""Called with a robot's name and the exception that its code raised."""


class MemoryRun:
    """A run in this process, from its first step to its last.

    `capture` receives the radio frames; `wrap` is called with each participant's name and end of the bus, and returns
    the end to use; `view` is a viewer; `wait` is called before each step, which it may delay. `on_crash` is called when
    a robot's code raises, which loses the robot; without it, the exception propagates. `journals` is the directory for
    journals of robots that may be restarted; by default, they are kept in memory. `missed` is the record of a run by
    the wall clock (`Records.missed`), which this run repeats. `held` has the robots that wait at the end of each step
    for the caller (`agent.process.AgentNode.decide`).

    Raises ScenarioError if the scenario's clock is the wall clock, and there is no record.
    """

    def __init__(
        self,
        plan: Plan,
        capture: BinaryIO | None = None,
        *,
        wrap: Callable[[str, Bus], Bus] = lambda _, bus: bus,
        view: Node | None = None,
        wait: Callable[[], object] = lambda: None,
        on_crash: OnCrash | None = None,
        journals: Path | None = None,
        missed: Sequence[Missed] | None = None,
        held: Collection[int] = (),
    ) -> None:
        check_clock(plan.scenario, missed)
        robots = plan.scenario.robots
        self._robots = [names.robot(number) for number in range(robots)]
        watching = [names.VIEW] if view is not None else []
        self._plan = plan
        self._wrap = wrap
        self._on_crash = on_crash
        self._journals = journals
        self._held = held
        self._kept: dict[int, BytesIO] = {}
        self._shared: dict[str, Any] = {}
        """Caches that the robots share (`agent.robot.Robot.share`)."""
        self._due: list[int] = []
        """Robots that are to be restarted."""
        self._hub = MemoryHub("memory", [names.RELAY, names.WORLD, names.RECORDER, *self._robots, *watching])
        keys = self._hub.keys
        self._buses: dict[str, Bus] = {}
        for name in (names.RELAY, *watching, names.RECORDER, names.WORLD, *self._robots):
            self._buses[name] = wrap(name, self._hub.join(name))
        shape, on_fault = plan.map.cells.shape, _note_restarts(self._due)
        self._recorder = RecorderNode(self._buses[names.RECORDER], keys, robots, shape, capture, on_fault)
        world = plan.make_world()
        self._reachable = np.flatnonzero(world.reachable)
        self._world = WorldNode(
            self._buses[names.WORLD],
            keys,
            world,
            plan.scenario.steps,
            1000 * plan.map.resolution,
            wait=wait,
            incarnations=plan.incarnations,
            clock=RecordedClock(missed) if missed is not None else None,
        )
        self._relay = RelayNode(
            self._buses[names.RELAY],
            keys,
            plan.radio,
            captures=capture is not None,
            clock=RecordedPhases(missed) if missed is not None else None,
        )
        self._nodes: dict[str, Node] = {
            names.RELAY: self._relay,
            names.WORLD: self._world,
            names.RECORDER: self._recorder,
        }
        self.agents = [self._agent(number) for number in range(robots)]
        """The robots' nodes, by number; a restarted robot has a new one."""
        self._nodes |= zip(self._robots, self.agents, strict=True)
        if view is not None:
            self._nodes[names.VIEW] = view
        self._recorder.configure(plan.robot_settings)
        self.records.known_at = 0

    @property
    def records(self) -> Records:
        """Everything that the recorder has recorded so far."""
        return self._recorder.records

    def ask(self, request: FaultEvent | Change) -> None:
        """Request a fault or a change of the radio that the scenario does not contain."""
        self._recorder.request(request)

    def steps(self, heed: Callable[[RecorderNode], object] = lambda _: None) -> Iterator[int]:
        """Run, and yield each completed step, from 0, the time before the first.

        At this point the step is recorded, and the world has opened the next one, but no robot has received it.
        While robots are held, yield the last completed step again and again: the caller must let them decide.
        `heed` may end the run early (`deploy.run.interrupt`).
        """
        over = -1
        while not self._is_done():
            received = False
            heed(self._recorder)
            for name in self._hub.in_turn():
                received |= self._process_messages(name)
                if name == names.RECORDER:
                    self._end_lost()
                    if self._last_step() > over:
                        over = self._last_step()
                        self._note_full_map(over)
                        yield over
            while self._due:
                self._restart(self._due.pop())
            if received or self._is_done():
                continue
            if any(agent.situation is not None and not agent.done for agent in self.agents):
                yield over
            else:
                self._time_out()

    def complete(
        self,
        watch: Callable[[Records], object] | None = None,
        heed: Callable[[RecorderNode], object] = lambda _: None,
    ) -> Records:
        """Run to the end, and return the records; `watch` is called whenever a step has been opened."""
        opened = 0
        with _rare_collections():
            for _ in self.steps(heed):
                if watch is not None and self.records.step > opened:
                    opened = self.records.step
                    watch(self.records)
        return self.records

    def _note_full_map(self, step: int) -> None:
        """Record a step at whose end a robot knew the full map for the first time.

        Approximations may claim cells that no robot has seen, so the team must have seen as many cells.
        """
        records = self.records
        if records.known_at or not 0 < step <= len(records.world):
            return
        report = records.world[step - 1]
        if report.seen < FULL_SHARE * report.reachable:
            return
        robots = (agent.robot for agent in self.agents if not agent.done)
        if any(knows_all(robot.planning, self._reachable) for robot in robots if robot is not None):
            records.known_at = step

    def _time_out(self) -> None:
        """Give up on the robots that others wait for: no messages are left, so that none of them will answer."""
        overdue = {robot: node for node in (self._relay, self._world) for robot in node.waiting_for()}
        for robot, node in overdue.items():
            node.give_up_on(robot, "timed out")
        if not overdue and self._recorder.records.end is not None and not self._recorder.done:
            self._recorder.give_up_requested()
        elif not overdue:
            raise RuntimeError("deadlock: all participants wait for each other")

    def _end_lost(self) -> None:
        """End the robots that the run continues without, as a launcher ends their processes."""
        for robot in self._recorder.records.lost:
            if not self.agents[robot].done:
                self.agents[robot].done = True
                self._buses[self._robots[robot]].close()

    def _process_messages(self, name: str) -> bool:
        """Let a participant process its messages; return whether there were any."""
        node, bus, messages = self._nodes[name], self._buses[name], self._hub.end(name).messages
        received = False
        try:
            while messages and (message := bus.receive(0)) is not None:
                received = True
                node.handle(message)
        except Exception as error:
            if self._on_crash is None or not isinstance(node, AgentNode):
                raise
            self._on_crash(name, error)
            node.done = True
        if node.done:
            bus.close()
        return received

    def _restart(self, number: int) -> None:
        """Let a robot join again, with its journal."""
        name = self._robots[number]
        self._buses[name] = self._wrap(name, self._hub.join(name))
        self._nodes[name] = self.agents[number] = self._agent(number)

    def _agent(self, number: int) -> AgentNode:
        bus = self._buses[self._robots[number]]
        keys, journal, held = self._hub.keys, self._journal(number), number in self._held
        return AgentNode(bus, keys, number, journal, self._shared, held=held)

    def _journal(self, number: int) -> Journal | None:
        """Return a robot's journal; None if robots are not restarted in this run."""
        if self._plan.incarnations == 1:
            return None
        if self._journals is not None:
            return Journal.open(self._journals / journal_name(number))
        return Journal(self._kept.setdefault(number, BytesIO()))

    def _last_step(self) -> int:
        """Return the last completed step: the last of the run, or the one before the step that the world has opened."""
        records = self._recorder.records
        return records.end.step if records.end is not None else records.step - 1

    def _is_done(self) -> bool:
        return all(node.done for node in self._nodes.values())


@contextmanager
def _rare_collections() -> Iterator[None]:
    """Let the garbage collector run rarely: it visits the state of all robots, but a run has few reference cycles."""
    before = gc.get_threshold()
    if before[0]:
        gc.set_threshold(max(before[0], GARBAGE), *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)


def check_clock(scenario: Scenario, missed: Sequence[Missed] | None) -> None:
    """Raise ScenarioError if a scenario in this process needs the wall clock: only its repetition does not."""
    if scenario.clock == "wall" and missed is None:
        raise ScenarioError(
            "clock = 'wall': robots of one process cannot be late; with this clock, bus must be 'zenoh'"
        )


def _note_restarts(due: list[int]) -> Callable[[FaultEvent], object]:
    """Return a callback that notes restarts in `due`, without a reference to the run."""
    return lambda event: due.append(event.robot) if event.kind == "restart" else None
