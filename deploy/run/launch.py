"""A run as processes: relay, world and robots as child processes, the recorder in this process.

All processes start at once and join the bus at the relay's hub. The robots of a `Fleet` run on other hosts and join
the same hub.
"""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import BinaryIO

from agent.journal import journal_name
from deploy.dashboard.process import ViewTask
from deploy.dashboard.watch import announced
from deploy.record.map_history import MapHistory
from deploy.record.records import NO_MAPS, RecorderNode, Records
from deploy.run.gate import Gate
from deploy.run.limits import out_of_memory
from deploy.run.process_table import FORK_SERVER, UNKNOWN, ProcessTable
from deploy.run.processes import (
    WorldTask,
    Wrap,
    serve_agent,
    serve_relay,
    serve_router,
    serve_view,
    serve_world,
    silence_s,
)
from deploy.run.rendezvous import Rendezvous, behind, on_loopback
from deploy.run.reply_timeout import TIMED_OUT, RunningClock
from deploy.run.ssh import Fleet
from deploy.scenario.plan import Plan
from netshaper.process import ENDED
from protocol import keys as names
from protocol.bus import Bus, BusClosed
from protocol.keys import Keys
from protocol.messages import FaultEvent
from protocol.temporary import temporary_folder
from protocol.zenoh_bus import join

POLL_S = 0.25
VIEWER_S = 10.0
"""Time limit for the viewer to join; then the run starts without it."""
FAREWELL_S = 1.0
"""Time limit for the process of a lost robot to end."""
VIEWER_END_S = 5.0
"""Time limit for the viewer to finish its recording."""
WRAP_UP_S = 3.0
"""Time limit for the end of the run after it has failed, or was interrupted before its first step."""
FORK_SERVER_DIED = f"{FORK_SERVER} died"

Heed = Callable[[RecorderNode], bool]
"""Called repeatedly: ends the run early on request, and returns whether that was requested (`Interrupt.heed`)."""


@dataclass
class Outcome:
    """The result of a launch: the records, and the crash report of each process that ended unexpectedly."""

    records: Records
    deaths: dict[str, str]
    hub_fault: str = ""
    """Why the hub cannot listen at its address, so that nothing was run; empty if it listened."""
    view_fault: str = ""
    """Error of the viewer, without which the run continued; empty if there was none."""
    failures: list[OSError] = field(default_factory=list)
    """Errors of files that could not be written during the run; each names its file."""


@dataclass(frozen=True)
class Show:
    """A viewer of the run: its task, and a function to call once it has joined."""

    task: ViewTask
    ready: Callable[[], object]


def run(
    plan: Plan,
    logs: Path | None,
    watch: Callable[[Records], object] | None = None,
    capture: BinaryIO | None = None,
    *,
    heed: Heed = lambda _: False,
    show: Show | None = None,
    pace: float | None = None,
    live: Path | None = None,
    fleet: Fleet | None = None,
    rendezvous: Rendezvous | None = None,
    journals: Path | None = None,
    free: int = 0,
    revive: bool = False,
    gate: Gate | None = None,
    wrap: Wrap | None = None,
) -> Outcome:
    """Run a plan as processes.

    `logs` is the directory for their output, by default a temporary one. `watch` is called with the records a few times
    per second; `heed` may end the run early. `capture` receives the radio frames. The run takes at most `pace` steps
    per second, except for the first `free` steps; a `gate` delays steps instead. `live` is the directory for the file
    from which viewers can join (`deploy.dashboard.watch`). Robots of a `fleet` run on other hosts; else the processes
    meet at `rendezvous`, by default on the loopback interface. `journals` is the directory of the robots' journals;
    `revive` restarts robots that end unexpectedly. `wrap`, which must be picklable, wraps the bus of each participant
    here.
    """
    timeout_s = plan.scenario.reply_timeout_s
    world = WorldTask(
        plan.make_world(), plan.scenario.steps, 1000 * plan.map.resolution, pace, free, timeout_s,
        revive=revive, gate=gate, incarnations=plan.incarnations,
    )  # fmt: skip
    port = show.task.port if show is not None else None
    with contextlib.ExitStack() as stack:
        folder = logs or stack.enter_context(temporary_folder())
        journals = journals or (folder if logs is None else folder.parent) / "journals"
        rendezvous = (
            fleet.rendezvous if fleet is not None else rendezvous or on_loopback(plan.scenario.robots)
        )
        processes = stack.enter_context(ProcessTable(folder, timeout_s))
        if fleet is not None:
            stack.enter_context(fleet.running(rendezvous.credentials, folder))
        table: dict[str, Callable[..., None]] = {
            names.RELAY: partial(
                serve_relay, rendezvous, plan.radio, timeout_s, world.pause_s,
                captures=capture is not None, may_return=plan.incarnations > 1,
            ),
            names.WORLD: partial(serve_world, rendezvous.credentials[names.WORLD], world, wrap),
            **_robots(plan, rendezvous, set(fleet.robots) if fleet is not None else set(), journals, wrap),
        }  # fmt: skip
        supervisor = _Supervisor(processes, table, fleet)
        stack.enter_context(announced(live, rendezvous.credentials[names.VIEW], port))
        try:
            if (fault := supervisor.start()) or supervisor.deaths:
                return Outcome(no_records(plan), supervisor.deaths, hub_fault=fault)
            if show is not None:
                _start_viewer(processes, rendezvous, show)
        except ConnectionError as error:
            return Outcome(no_records(plan), {FORK_SERVER: str(error)})
        outcome = _record(supervisor, rendezvous, plan, world.pause_s, heed, watch, capture, wrap)
        if show is not None:
            outcome.view_fault = processes.await_end(names.VIEW, VIEWER_END_S)
        return outcome


def _robots(
    plan: Plan, rendezvous: Rendezvous, elsewhere: set[str], journals: Path, wrap: Wrap | None
) -> dict[str, Callable[[], None]]:
    """Return the tasks of the robots on this host, and of the routers between them and the hub, by name."""
    table: dict[str, Callable[[], None]] = {}
    credentials = dict(rendezvous.credentials)
    for router in [each for each in rendezvous.credentials.values() if each.robots]:
        if elsewhere.isdisjoint(router.robots):
            there = behind(router)
            table[router.name] = partial(serve_router, router, there)
            credentials |= there.credentials
    for number in range(plan.scenario.robots):
        name = names.robot(number)
        if name not in elsewhere:
            journal = journals / journal_name(number) if plan.incarnations > 1 else None
            table[name] = partial(serve_agent, credentials[name], journal, wrap)
    return table


class _Supervisor:
    """Starts, restarts and ends the processes of a run, and collects the unexpected ends."""

    def __init__(
        self, processes: ProcessTable, table: dict[str, Callable[..., None]], fleet: Fleet | None
    ) -> None:
        self.deaths = processes.deaths
        """Processes and hosts that ended unexpectedly, each with its crash report."""
        self._processes = processes
        self._table = table
        self._fleet = fleet
        self._ended: set[int] = set()
        self._reported: set[str] = set()
        """Robots whose processes have ended, which the relay knows."""

    def start(self) -> str:
        """Start all processes, the others once the hub listens; return why it cannot listen, empty if it does.

        If the relay ends before, the others are not started, and `deaths` has its crash report. ConnectionError if a
        process cannot be started.
        """
        here, there = multiprocessing.Pipe(duplex=False)
        with contextlib.closing(here):
            with contextlib.closing(there):
                relay = partial(self._table[names.RELAY], opened=there)
                self._processes.start(names.RELAY, relay)
            fault = None
            with contextlib.suppress(EOFError):
                fault = str(here.recv())
        if fault != "":
            self._processes.await_end(names.RELAY, FAREWELL_S)
            self.check()
            return fault or ""
        for name, task in self._table.items():
            if name != names.RELAY:
                self._processes.start(name, task)
        return ""

    def apply(self, event: FaultEvent) -> None:
        """Apply a fault to a robot's process: expect its end, or restart it."""
        name = names.robot(event.robot)
        if event.kind == "restart":
            self._processes.give_up(name)
        if event.kind in ("kill", "restart"):
            self._processes.excuse(name)
        if event.kind == "restart":
            try:
                self._processes.start(name, self._table[name])
            except ConnectionError as error:
                self.deaths[FORK_SERVER] = str(error)
            self._reported.discard(name)

    def newly_ended(self) -> list[int]:
        """Return the robots whose processes are known to have ended since the last call."""
        codes = self._processes.ended()
        ended = {name for name in codes if names.is_robot(name) and codes[name] != UNKNOWN} - self._reported
        self._reported |= ended
        return sorted(map(names.number, ended))

    def check(self) -> dict[str, str]:
        """Update `deaths` and return it."""
        if self._fleet is not None:
            self._fleet.check(self.deaths)
        return self._processes.check()

    def end_lost(self, lost: Mapping[int, str]) -> None:
        """End the processes of robots that the run continues without, once each."""
        self._ended.intersection_update(lost)
        for robot in lost.keys() - self._ended:
            self._ended.add(robot)
            if lost[robot] != ENDED:
                self._processes.give_up(names.robot(robot), hangs=lost[robot].startswith(TIMED_OUT))
                if self._fleet is not None:
                    self._fleet.give_up(names.robot(robot))

    def conclude(self, records: Records) -> None:
        """End lost robots, wait for processes that leave, and remove the deaths that the end of the relay caused.

        Causes of losses then name the hosts of the robots.
        """
        if records.end is not None and records.end.step < 0:
            time.sleep(POLL_S)  # the process ends a moment after it has left the bus
        self.end_lost(records.lost)
        for robot, cause in records.lost.items():
            if cause == ENDED:
                self._processes.await_end(names.robot(robot), FAREWELL_S)
        self.check()
        if names.RELAY in self.deaths:
            self._processes.forget_disconnected()
            if self._fleet is not None:
                self._fleet.forget_disconnected(self.deaths)
        for name, host in (self._fleet.robots if self._fleet is not None else {}).items():
            if records.lost.get(names.number(name), NO_MAPS) != NO_MAPS:
                records.lost[names.number(name)] += f"; it ran on host {host}"


def _start_viewer(processes: ProcessTable, rendezvous: Rendezvous, show: Show) -> None:
    """Start the viewer, and wait for it up to `VIEWER_S`, so that it receives the first steps."""
    here, there = multiprocessing.Pipe(duplex=False)
    task = partial(serve_view, rendezvous.credentials[names.VIEW], show.task, there)
    processes.start(names.VIEW, task, needed=False)
    there.close()
    with contextlib.suppress(EOFError):
        if here.poll(VIEWER_S) and here.recv():
            show.ready()


def _record(
    supervisor: _Supervisor,
    rendezvous: Rendezvous,
    plan: Plan,
    pause_s: float,
    heed: Heed,
    watch: Callable[[Records], object] | None,
    capture: BinaryIO | None,
    wrap: Wrap | None,
) -> Outcome:
    """Serve as the recorder until the run is over."""
    try:
        bus: Bus = join(rendezvous.credentials[names.RECORDER])
    except ConnectionError as error:
        supervisor.check().setdefault(names.RELAY, str(error))
        return Outcome(no_records(plan), supervisor.deaths)
    if wrap is not None:
        bus = wrap(names.RECORDER, bus)
    keys, robots, shape = Keys(rendezvous.run), plan.scenario.robots, plan.map.cells.shape
    recorder = RecorderNode(bus, keys, robots, shape, capture, supervisor.apply)
    recorder.configure(plan.robot_settings)

    def poll() -> bool:
        if watch is not None:
            watch(recorder.records)
        supervisor.end_lost(recorder.records.lost)
        for robot in supervisor.newly_ended():
            recorder.report_end(robot)
        if supervisor.check() and not recorder.records.world:
            recorder.shut_down()  # a participant died before the first step
        elif FORK_SERVER in supervisor.deaths:
            recorder.stop(FORK_SERVER_DIED)
        return bool({names.WORLD, FORK_SERVER} & supervisor.deaths.keys())

    timeout_s = plan.scenario.reply_timeout_s
    with contextlib.closing(bus):
        try:
            attend(bus, recorder, heed, poll, timeout_s, 2 * silence_s(timeout_s, pause_s))
        except BusClosed as error:
            time.sleep(POLL_S)  # the process ends a moment after it has left the bus
            supervisor.check().setdefault(names.RELAY, str(error))
        except MemoryError:
            supervisor.deaths[names.RECORDER] = out_of_memory()
    supervisor.conclude(recorder.records)
    return Outcome(recorder.records, supervisor.deaths)


def no_records(plan: Plan) -> Records:
    """Return the records of a run that has not begun."""
    return Records(plan.scenario.robots, MapHistory(plan.map.cells.shape))


def attend(
    bus: Bus,
    recorder: RecorderNode,
    heed: Heed,
    poll: Callable[[], bool],
    reply_timeout_s: float,
    quiet_s: float,
) -> None:
    """Serve as the recorder until all data are recorded, or no more arrive.

    `poll` is called at least once, then a few times per second, and returns whether the run has failed, which ends it.
    `reply_timeout_s` is the time limit for the end of an interrupted step, and for each part of the robots' maps.

    Raises BusClosed if the connection to the relay is lost, or no message has arrived for `quiet_s` seconds.
    """
    ending: float | None = None
    progress: object = None
    clock = RunningClock()
    received = clock()
    polled = -math.inf  # also a run that is over within POLL_S is polled
    while not recorder.done:
        message = bus.receive(POLL_S)
        now = clock()
        if message is not None:
            received = now
            recorder.handle(message)
        if now - polled < POLL_S:
            continue
        polled = now
        failed, interrupted = poll(), heed(recorder)
        if now - received > quiet_s:
            raise BusClosed(f"no message from the relay for {quiet_s:g} s")
        is_over = recorder.records.end is not None
        now_at = is_over, recorder.parts_received, len(recorder.missing())
        if (failed or interrupted or is_over) and now_at != progress:
            ending, progress = now, now_at
        waits = is_over or (recorder.records.step > 0 and not failed)
        if ending is not None and now - ending > (reply_timeout_s if waits else WRAP_UP_S):
            recorder.give_up_requested()
