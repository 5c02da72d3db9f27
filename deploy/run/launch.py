"""A run as processes: relay, world and robots in a `ProcessTable`, the laboratory in this process.

One table says what runs; all of it starts at once and meets at the hub; nothing sleeps. Robots that a `Fleet` has
run on other hosts, and meet the rest at the same hub.
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

from agent.journal import journal_name
from deploy.dashboard.process import ViewTask
from deploy.dashboard.watch import announced
from deploy.record.map_history import MapHistory
from deploy.record.records import RecorderNode, Records
from deploy.record.wire_bytes import Meter
from deploy.run.gate import Gate
from deploy.run.process_table import FORK_SERVER, ProcessTable
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
from deploy.run.ssh import Fleet
from deploy.scenario.plan import Plan
from netshaper.process import ENDED
from protocol import keys as names
from protocol.bus import Bus, BusClosed
from protocol.keys import Keys
from protocol.messages import FaultEvent
from protocol.zenoh_bus import join

POLL_S = 0.25
VIEWER_S = 10.0
"""How long the viewer may take to join; after that the run begins without it."""
FAREWELL_S = 1.0
"""How long a lost robot's process may take to end."""
VIEWER_END_S = 5.0
"""How long the viewer may take to write what it has at the end."""
WRAP_UP_S = 3.0
"""How long the others may be silent once the run is over or was interrupted, and something is not handed in."""

Heed = Callable[[RecorderNode], bool]
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
    fleet: Fleet | None = None,
    rendezvous: Rendezvous | None = None,
    journals: Path | None = None,
    free: int = 0,
    revive: bool = False,
    gate: Gate | None = None,
    wrap: Wrap | None = None,
) -> Outcome:
    """Run a plan as processes; `watch` is called as records come in, at most a few times a second.

    What the processes print goes to files in `logs`, or is gone after the run if that is None; `capture`
    takes the frames (`deploy.record.records`); `heed` may end it early; `show` adds a viewer; `pace` is the steps a
    second at most, but of the first `free` ones; `live` is a directory in which to say how to look at the run
    (`deploy.dashboard.watch`); `fleet`, whose hosts have been reached, runs its robots there, and says where all meet;
    without it that is `rendezvous`, or on the loopback. Where robots may come back (`Plan.incarnations`) their journals are in
    the folder `journals`; with `revive` those that are lost unasked are started again. `wrap`, which must be picklable,
    may lay something around the ends of the bus of world, laboratory and robots here. `gate` is what the world passes
    before it opens a step, where the run is controlled (`deploy.run.control`).
    """
    if logs is None:
        with tempfile.TemporaryDirectory() as folder:
            return run(
                plan,
                Path(folder),
                watch,
                capture,
                heed=heed,
                show=show,
                pace=pace,
                live=live,
                fleet=fleet,
                rendezvous=rendezvous,
                journals=journals or Path(folder) / "journals",
                free=free,
                revive=revive,
                gate=gate,
                wrap=wrap,
            )
    robots, reply_timeout = plan.scenario.robots, plan.scenario.reply_timeout_s
    world = WorldTask(
        plan.make_world(),
        plan.scenario.steps,
        1000 * plan.map.resolution,
        pace,
        free,
        reply_timeout,
        revive,
        gate,
        plan.incarnations,
    )
    rendezvous = fleet.rendezvous if fleet is not None else rendezvous or on_loopback(robots)
    elsewhere = fleet.robots if fleet is not None else set()
    with (
        ProcessTable(logs) as processes,
        fleet.running(rendezvous.credentials, logs) if fleet is not None else contextlib.nullcontext(),
    ):
        table: dict[str, tuple[Callable[..., None], *tuple[object, ...]]] = {
            names.RELAY: (
                serve_relay,
                rendezvous.run,
                rendezvous.endpoint,
                rendezvous.credentials,
                plan.radio,
                rendezvous.certificate,
                reply_timeout,
                world.pause_s,
                capture is not None,
            ),
            names.WORLD: (serve_world, rendezvous.credentials[names.WORLD], world, wrap),
        }
        journals = journals or logs.parent / "journals"
        credentials = dict(rendezvous.credentials)
        for router in [each for each in rendezvous.credentials.values() if each.robots]:
            if elsewhere.isdisjoint(router.robots):
                there = behind(router)
                table[router.name] = (serve_router, router, there.endpoint, there.credentials)
                credentials |= there.credentials
        for number, name in enumerate(map(names.robot, range(robots))):
            if name not in elsewhere:
                journal = journals / journal_name(number) if plan.incarnations > 1 else None
                table[name] = (serve_agent, credentials[name], journal, wrap)

        def obey(event: FaultEvent) -> None:
            name = names.robot(event.robot)
            if event.kind == "restart":
                processes.give_up(name)
            if event.kind in ("kill", "restart"):
                processes.excuse(name)
            if event.kind == "restart":
                serve, *args = table[name]
                processes.start(name, serve, *args)

        port = show.task.port if show is not None else None
        with announced(live, rendezvous.credentials[names.VIEW], port):
            for name, (serve, *args) in table.items():
                processes.start(name, serve, *args)
            if show is not None:
                _start_viewer(processes, rendezvous, show)
            outcome = _attend(
                processes, rendezvous, fleet, plan, world.pause_s, heed, watch, capture, obey, wrap
            )
            if show is not None:
                outcome.view_fault = processes.await_end(names.VIEW, VIEWER_END_S)
            return outcome


def _start_viewer(processes: ProcessTable, rendezvous: Rendezvous, show: Show) -> None:
    """Start the viewer, and wait a little for it, so that it sees the first steps; it is not needed."""
    here, there = multiprocessing.Pipe(duplex=False)
    processes.start(
        names.VIEW, serve_view, rendezvous.credentials[names.VIEW], show.task, there, needed=False
    )
    there.close()
    with contextlib.suppress(EOFError):
        if here.poll(VIEWER_S) and here.recv():
            show.ready()


def _attend(
    processes: ProcessTable,
    rendezvous: Rendezvous,
    fleet: Fleet | None,
    plan: Plan,
    pause_s: float,
    heed: Heed,
    watch: Callable[[Records], object] | None,
    capture: BinaryIO | None,
    obey: Callable[[FaultEvent], object],
    wrap: Wrap | None,
) -> Outcome:
    """Serve as the laboratory until the run is over."""
    deaths = processes.deaths
    ended: set[int] = set()

    def look_after_all() -> dict[str, str]:
        if fleet is not None:
            fleet.look(deaths)
        return processes.look()

    def end_the_lost(records: Records) -> None:
        """End the processes of robots that the run goes on without, once."""
        ended.intersection_update(records.lost)
        for robot in records.lost.keys() - ended:
            ended.add(robot)
            if records.lost[robot] != ENDED:
                processes.give_up(names.robot(robot))
                if fleet is not None:
                    fleet.give_up(names.robot(robot))

    try:
        bus: Bus = join(rendezvous.credentials[names.RECORDER])
    except ConnectionError as error:
        look_after_all().setdefault(names.RELAY, str(error))
        return Outcome(Records(plan.scenario.robots, MapHistory(plan.map.cells.shape)), deaths)
    if wrap is not None:
        bus = wrap(names.RECORDER, bus)
    meter = Meter(rendezvous.endpoint, here=True)
    recorder = RecorderNode(
        bus, Keys(rendezvous.run), plan.scenario.robots, plan.map.cells.shape, capture, meter, obey
    )
    recorder.configure(plan.robot_settings)

    def look() -> bool:
        if watch is not None:
            watch(recorder.records)
        end_the_lost(recorder.records)
        if look_after_all() and not recorder.records.world:
            recorder.shut_down()  # no first step can come
        return bool({names.WORLD, FORK_SERVER} & deaths.keys())

    with contextlib.closing(bus):
        try:
            attend(bus, recorder, heed, look, 2 * silence_s(plan.scenario.reply_timeout_s, pause_s))
        except BusClosed as error:
            time.sleep(POLL_S)  # the system tells of the death a moment after the bus
            look_after_all().setdefault(names.RELAY, str(error))
    if recorder.records.end is not None and recorder.records.end.step < 0:
        time.sleep(POLL_S)  # likewise
    for robot, cause in recorder.records.lost.items():
        if cause == ENDED:
            processes.await_end(
                names.robot(robot), FAREWELL_S
            )  # the relay has heard of it before the system tells
    look_after_all()
    if names.RELAY in deaths:
        processes.forget_who_left()
        if fleet is not None:
            fleet.forget_who_left(deaths)
    return Outcome(recorder.records, deaths)


def attend(bus: Bus, recorder: RecorderNode, heed: Heed, look: Callable[[], bool], quiet_s: float) -> None:
    """Serve as the laboratory until everything is recorded, or the participants that still owe data fall silent.

    `look` is called a few times a second, and returns whether the run is broken: then it ends as well.

    Raises
    ------
    BusClosed
        The connection to the relay is lost, or nothing has come for `quiet_s` seconds.
    """
    ending: float | None = None
    owed = -1
    heard = looked = time.monotonic()
    while not recorder.done:
        message = bus.receive(POLL_S)
        now = time.monotonic()
        if message is not None:
            heard = now
            recorder.handle(message)
        if now - looked < POLL_S:
            continue
        looked = now
        recorder.read_meter()
        broken, wished = look(), heed(recorder)
        if now - heard > quiet_s:
            raise BusClosed(f"the relay said nothing for {quiet_s:g} s")
        is_over = recorder.records.end is not None
        if (broken or wished or is_over) and (ending is None or owed != len(recorder.missing())):
            ending, owed = now, len(recorder.missing())
        if ending is not None and now - ending > WRAP_UP_S:
            recorder.finish_without_missing()
