"""The entry points of a run's processes: each joins the bus, serves as one participant, and leaves.

The fork server imports this module before any bus is opened, so that robots start with code and kernels in memory.
"""

from __future__ import annotations

import faulthandler
import os
import signal
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING

from setproctitle import setproctitle

from agent.journal import Journal, JournalError
from agent.process import AgentNode
from deploy.run import parent_watchdog
from deploy.run.crash_report import traceback_of
from deploy.run.exit_codes import BROKEN_OFF
from deploy.run.gate import LONGEST_PAUSE_S, Gate
from deploy.run.reply_timeout import REPLY_TIMEOUT_S, ReplyTimeout
from netshaper.hub import open_hub
from netshaper.phase_clock import WallPhases
from netshaper.process import DISCONNECTED, RelayNode
from netshaper.router import Router
from netshaper.settings import RadioSettings
from protocol import keys as names
from protocol.bus import Bus, BusClosed
from protocol.keys import Keys
from protocol.zenoh_bus import RECONNECT_S, Credential, ZenohBus, join, send_along
from worldsim.base import BaseWorld
from worldsim.clock import WallClock
from worldsim.pace import Pace
from worldsim.process import WorldNode

if TYPE_CHECKING:
    from deploy.dashboard.process import ViewTask
    from deploy.run.rendezvous import Rendezvous

POLL_S = 0.25
FAREWELL_S = 2.0
"""Time limit for the others to leave once everything is recorded."""

Wrap = Callable[[str, Bus], Bus]
"""Wraps a participant's end of the bus; called with its name."""


@dataclass(frozen=True)
class WorldTask:
    """The task of the world's process."""

    world: BaseWorld
    steps: int
    cell_mm: float
    pace: float | None = None
    """Maximum steps per second; None: unlimited."""
    free: int = 0
    """Number of first steps without the limit of `pace`."""
    reply_timeout_s: float = REPLY_TIMEOUT_S
    """Time limit for a robot's move."""
    revive: bool = False
    """Whether robots that end unexpectedly are restarted."""
    gate: Gate | None = None
    """Delays the world before each step, instead of `pace`, if the run is controlled."""
    incarnations: int = 1
    """How often each robot may start: once, and once more for each restart."""

    @property
    def pause_s(self) -> float:
        """Maximum pause between two steps in seconds."""
        if self.gate is not None:
            return LONGEST_PAUSE_S
        return max(1 / self.pace if self.pace else 0.0, (self.world.settings.step_ns or 0) / 1e9)

    @property
    def wait(self) -> Callable[[], object]:
        """The function that the world calls before it opens a step."""
        if self.gate is not None:
            return self.gate.wait
        return Pace(self.pace, self.free).wait if self.pace else lambda: None


def serve_relay(
    rendezvous: Rendezvous,
    settings: RadioSettings,
    reply_timeout_s: float,
    pause_s: float,
    *,
    captures: bool,
    may_return: bool,
    opened: Connection,
) -> None:
    """Serve as the hub and relay of a run until all participants have left; they must join in time.

    `opened` is sent an empty text once the hub listens, or else why it cannot.
    """
    run = rendezvous.run
    try:
        hub = open_hub(run, rendezvous.endpoint, rendezvous.credentials, rendezvous.certificate)
    except ConnectionError as error:
        opened.send(str(error))
        raise
    opened.send("")
    with closing(hub) as bus:
        relay(
            bus, run, settings, reply_timeout_s, pause_s,
            waits=False, captures=captures, may_return=may_return,
        )  # fmt: skip


def relay(
    bus: ZenohBus,
    run: str,
    settings: RadioSettings,
    reply_timeout_s: float,
    pause_s: float = 0.0,
    notify: Callable[[str], object] = lambda _: None,
    *,
    waits: bool = True,
    captures: bool = True,
    may_return: bool = False,
) -> str:
    """Serve as the relay at an open hub until all participants have left; return why it has broken off the run.

    `pause_s` is the world's maximum pause between two steps. `notify` is called with the missing participants whenever
    they change. Unless the relay `waits`, the run ends if no participant joins within `reply_timeout_s`. Lost robots
    take part again if they `may_return`.
    """
    clock = None if settings.step_ns is None else WallPhases(settings.step_ns, settings)
    node = RelayNode(
        bus, Keys(run), settings, captures=captures, resend=bus.resend, may_return=may_return, clock=clock
    )
    reply_timeout = ReplyTimeout(node, reply_timeout_s)
    away: dict[int, float] = {}
    reported: list[str] = []
    while not node.done:
        work(bus, node)
        away = _awaited(node, away) if node.away or away else {}
        idle = reply_timeout.check()
        if node.shutting_down and idle > FAREWELL_S:
            break
        missing = node.missing()
        if missing and idle > reply_timeout_s and not waits:
            node.break_off(f"{', '.join(missing)} did not join within {reply_timeout_s:g} s")
        if not missing and idle > silence_s(reply_timeout_s, pause_s) and not node.waiting_for():
            node.break_off(f"no message from the world for {idle:.0f} s")
        if missing != reported:
            reported = missing
            notify(f"waiting for {', '.join(missing)}" if missing else "all participants have joined")
    return node.fault or ""


def work(bus: Bus, node: RelayNode | WorldNode) -> None:
    """Wait for a message, at most `POLL_S` seconds and not beyond the node's deadline, and process it.

    If none comes, the node notes the time: messages that are waiting count as in time.
    """
    due = node.deadline(time.monotonic_ns())
    left_s = POLL_S if due is None else min(POLL_S, max(0, due - time.monotonic_ns()) / 1e9)
    message = bus.receive(left_s)
    if message is not None:
        node.handle(message)
    else:
        node.tick(time.monotonic_ns())


def _awaited(node: RelayNode, since: Mapping[int, float]) -> dict[int, float]:
    """Give up robots that have been away for too long; return since when the others are away."""
    now = time.monotonic()
    away = {robot: since.get(robot, now) for robot in node.away}
    for robot, left in away.items():
        if now - left > RECONNECT_S:
            node.give_up_on(robot, DISCONNECTED)
    return away


def silence_s(reply_timeout_s: float, pause_s: float) -> float:
    """Return the time limit for a message of the world, in seconds; the world itself waits for robots."""
    return 2 * reply_timeout_s + pause_s


def serve_world(credential: Credential, task: WorldTask, wrap: Wrap | None = None) -> None:
    """Serve as the world of a run."""
    joined, bus = _joined(credential, wrap)
    step_ns = task.world.settings.step_ns
    node = WorldNode(
        bus,
        Keys(credential.run),
        task.world,
        task.steps,
        task.cell_mm,
        wait=task.wait,
        revive=task.revive,
        incarnations=task.incarnations,
        resend=joined.resend,
        clock=None if step_ns is None else WallClock(step_ns),
    )
    reply_timeout = ReplyTimeout(node, task.reply_timeout_s)
    with closing(bus):
        while not node.done:
            work(bus, node)
            reply_timeout.check()


def serve_router(credential: Credential, robots: Rendezvous) -> None:
    """Serve as the router of a host's robots, which meet at the rendezvous `robots`, until the hub is gone."""
    with closing(Router(credential, robots.endpoint, robots.credentials)) as router:
        router.serve()


def schedule_as_batch() -> None:
    """Use Linux's batch scheduling, so that a woken process waits until a processor is free.

    Robots outnumber processors and wake up at the same time: otherwise each would interrupt the relay, which still
    sends messages to the others. Call this before zenoh opens, so that its threads inherit the policy.
    """
    with suppress(AttributeError, OSError):
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def serve_agent(credential: Credential, journal: Path | None = None, wrap: Wrap | None = None) -> None:
    """Serve as one robot of a run; with a `journal` it can be restarted.

    ConnectionError if the bus cannot be joined, or if an earlier process of this robot has begun without a journal.
    """
    number = names.number(credential.name)
    try:
        kept = Journal.open(journal) if journal is not None else None
        schedule_as_batch()
        joined, bus = _joined(credential, wrap)
        node = AgentNode(bus, Keys(credential.run), number, kept, resend=joined.resend)
        _serve_robot(bus, node, lambda: kept is None and joined.misses_messages)
    except (JournalError, OSError) as error:
        if isinstance(error, ConnectionError):
            raise
        sys.exit(f"{journal}: {getattr(error, 'strerror', None) or error}")


def serve_view(credential: Credential, task: ViewTask, ready: Connection) -> None:
    """Serve as the viewer of a run, which only receives; send True to `ready` once it has joined."""
    from deploy.dashboard import process  # noqa: PLC0415  only the viewer needs its imports

    process.serve(credential, task, lambda: ready.send(True))


def _joined(credential: Credential, wrap: Wrap | None) -> tuple[ZenohBus, Bus]:
    """Join the bus; return this end of it, and the end to use."""
    if credential.certificate is None:
        send_along()
    bus = join(credential)
    return bus, bus if wrap is None else wrap(credential.name, bus)


def _serve_robot(bus: Bus, node: AgentNode, is_second: Callable[[], bool]) -> None:
    """Process messages until the robot is done; ConnectionError if an earlier process has received its messages."""
    with closing(bus):
        while not node.done:
            message = bus.receive()
            if is_second():
                raise ConnectionError(
                    "an earlier process of this robot has begun the run, and its maps are lost: "
                    "a robot that is started by hand cannot start again"
                )
            if message is not None:
                node.handle(message)
        if node.killed:
            os.kill(os.getpid(), signal.SIGKILL)


def in_background(name: str, log: Path, serve: Callable[[], None]) -> None:
    """Run `serve` as a child of the launcher: its output goes to `log`; the launcher handles Ctrl-C and SIGHUP.

    On SIGUSR1, the child prints what each of its threads does.
    """
    setproctitle(f"murmur {name}")
    parent_watchdog.end_with_parent(parent_watchdog.GRACE_S)
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    try:
        file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
        os.dup2(file, 1)
        os.dup2(file, 2)
        faulthandler.register(signal.SIGUSR1, file=2)
    except FileNotFoundError:
        sys.exit(BROKEN_OFF)  # the launcher has ended and removed the directory
    except OSError as error:
        print(f"{log}: {error.strerror}", file=sys.stderr)  # the run continues without this file
    try:
        serve()
    except (BusClosed, ConnectionError) as error:
        print(error, file=sys.stderr)
        sys.exit(BROKEN_OFF)
    except Exception as error:
        print(traceback_of(error), file=sys.stderr)
        sys.exit(1)
