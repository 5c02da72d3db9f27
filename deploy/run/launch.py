"""A run as processes: relay, world and robots in a `ProcessTable`, the laboratory in this process.

One table lists the processes; all of them start at once and join the hub; nothing sleeps.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from deploy.dashboard.process import ViewTask
from deploy.dashboard.watch import announced
from deploy.record.records import LabNode, Records
from deploy.record.wire_bytes import Meter
from deploy.run.process_table import ProcessTable
from deploy.run.processes import WorldTask, serve_agent, serve_relay, serve_view, serve_world
from deploy.scenario.plan import Plan
from protocol import keys as names
from protocol.bus import Bus, BusClosed
from protocol.keys import Keys
from protocol.zenoh_bus import join

POLL_S = 0.25
VIEWER_S = 10.0
"""How long the viewer may take to join; after that the run begins without it."""
VIEWER_END_S = 5.0
"""How long the viewer may take to write what it has at the end."""
WRAP_UP_S = 3.0
"""How long the others may be silent once the run is over or was interrupted, and something is not handed in."""

Heed = Callable[[LabNode], bool]
"""Called repeatedly: ends the run early if that was requested, and returns whether it was (`Interrupt.heed`)."""


@dataclass
class Outcome:
    """The result of a launch: the records, and what went wrong, by process."""

    records: Records
    deaths: dict[str, str]
    view_fault: str = ""
    """What went wrong with the viewer; the run continued without it."""


@dataclass(frozen=True)
class Show:
    """A viewer of the run: its task, and what to call once it has joined."""

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
) -> Outcome:
    """Run a plan as processes; `watch` is called as records come in, at most a few times a second.

    The output of the processes goes to files in `logs`, or is discarded after the run if that is None; `capture`
    takes the frames (`deploy.record.records`); `heed` may end the run early; `show` adds a viewer; `pace` is the
    maximum of steps a second; `live` is a directory in which to write how to view the run (`deploy.dashboard.watch`).
    """
    if logs is None:
        with tempfile.TemporaryDirectory() as folder:
            return run(plan, Path(folder), watch, capture, heed=heed, show=show, pace=pace, live=live)
    robots = plan.scenario.robots
    world = WorldTask(plan.make_world(), plan.minds, plan.scenario.steps, 1000 * plan.map.resolution, pace)
    with ProcessTable(logs, robots) as processes:
        table: dict[str, tuple[Callable[..., None], *tuple[object, ...]]] = {
            names.RELAY: (serve_relay, processes.run, processes.endpoint, processes.credentials, plan.radio),
            names.WORLD: (serve_world, processes.credentials[names.WORLD], world),
        }
        for name in map(names.robot, range(robots)):
            table[name] = (serve_agent, processes.credentials[name])
        port = show.task.port if show is not None else None
        with announced(live, processes.credentials[names.VIEW], port):
            for name, (serve, *args) in table.items():
                processes.start(name, serve, *args)
            if show is not None:
                _start_viewer(processes, show)
            outcome = _attend(processes, robots, heed, watch, capture)
            if show is not None:
                outcome.view_fault = processes.await_end(names.VIEW, VIEWER_END_S)
            return outcome


def _start_viewer(processes: ProcessTable, show: Show) -> None:
    """Start the viewer, and wait for it briefly, so that it sees the first steps; the run does not need it."""
    here, there = multiprocessing.Pipe(duplex=False)
    processes.start(names.VIEW, serve_view, processes.credentials[names.VIEW], show.task, there, needed=False)
    there.close()
    with contextlib.suppress(EOFError):
        if here.poll(VIEWER_S) and here.recv():
            show.ready()


def _attend(
    processes: ProcessTable,
    robots: int,
    heed: Heed,
    watch: Callable[[Records], object] | None,
    capture: BinaryIO | None,
) -> Outcome:
    """Serve as the laboratory until the run is over."""
    deaths = processes.deaths
    try:
        bus = join(processes.credentials[names.LAB])
    except ConnectionError as error:
        processes.look().setdefault(names.RELAY, str(error))
        return Outcome(Records(robots), deaths)
    lab = LabNode(bus, Keys(processes.run), robots, capture, Meter(processes.endpoint))

    def look() -> bool:
        if watch is not None:
            watch(lab.records)
        if processes.look() and not lab.records.world:
            lab.send_home()  # the first step cannot begin
        return names.WORLD in deaths

    with contextlib.closing(bus):
        try:
            attend(bus, lab, heed, look)
        except BusClosed as error:
            time.sleep(POLL_S)  # the system reports the death slightly later than the bus
            processes.look().setdefault(names.RELAY, str(error))
    processes.look()
    return Outcome(lab.records, deaths)


def attend(bus: Bus, lab: LabNode, heed: Heed, look: Callable[[], bool]) -> None:
    """Serve as the laboratory until everything is recorded, or the participants that still owe data fall silent.

    `look` is called a few times a second, and returns whether the run is broken: then it ends as well.

    Raises
    ------
    BusClosed
        The connection to the relay is lost.
    """
    ending = False
    heard = looked = 0.0
    while not lab.done:
        message = bus.receive(POLL_S)
        now = time.monotonic()
        if message is not None:
            heard = now
            lab.handle(message)
        if now - looked < POLL_S:
            continue
        looked = now
        lab.read_meter()
        broken, wished = look(), heed(lab)
        if not ending and (broken or wished or lab.records.end is not None):
            ending, heard = True, now
        if ending and now - heard > WRAP_UP_S:
            lab.send_home()
