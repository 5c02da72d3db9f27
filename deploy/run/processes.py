"""The entry points of a run's processes: join the bus, serve, leave.

Imported by the fork server before any bus is opened, so that each robot starts with code and kernels in memory.
"""

from __future__ import annotations

import os
import signal
import sys
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
from deploy.run.gate import LONGEST_PAUSE_S, Gate
from deploy.run.reply_timeout import REPLY_TIMEOUT_S, ReplyTimeout
from netshaper.hub import open_hub
from netshaper.process import RelayNode
from netshaper.router import Router
from netshaper.settings import RadioSettings
from protocol import keys as names
from protocol.bus import Bus, BusClosed
from protocol.keys import Keys
from protocol.zenoh_bus import Certificate, Credential, join, send_along
from worldsim.pace import Pace
from worldsim.process import WorldNode
from worldsim.world import World

if TYPE_CHECKING:
    from deploy.dashboard.process import ViewTask

BROKEN_OFF = 3
POLL_S = 0.25
FAREWELL_S = 2.0
"""How long the relay waits for others to leave, once everything is recorded."""

Wrap = Callable[[str, Bus], Bus]
"""Lays something around a participant's end of the bus, by its name."""


@dataclass(frozen=True)
class WorldTask:
    """The task of the world's process."""

    world: World
    steps: int
    cell_mm: float
    pace: float | None = None
    """Steps a second at most, for people who watch."""
    free: int = 0
    """The first steps, which go as fast as they can all the same."""
    reply_timeout_s: float = REPLY_TIMEOUT_S
    """How long a robot may take for its move."""
    revive: bool = False
    """Whether robots that are lost unasked are to be started again."""
    gate: Gate | None = None
    """What it passes before it opens a step, instead of the pace, where the run is controlled."""
    incarnations: int = 1
    """How often each robot may start: once, and once more for each restart."""

    @property
    def pause_s(self) -> float:
        """Seconds that it waits between steps at most."""
        if self.gate is not None:
            return LONGEST_PAUSE_S
        return 1 / self.pace if self.pace else 0.0

    @property
    def wait(self) -> Callable[[], object]:
        """Called by the world before it opens a step."""
        if self.gate is not None:
            return self.gate.wait
        return Pace(self.pace, self.free).wait if self.pace else lambda: None


def serve_relay(
    run: str,
    endpoint: str,
    credentials: Mapping[str, Credential],
    settings: RadioSettings,
    certificate: Certificate | None = None,
    reply_timeout_s: float = REPLY_TIMEOUT_S,
    pause_s: float = 0.0,
    captures: bool = True,
) -> None:
    """Serve as the hub and relay of a run until all participants have left; all are to be here soon."""
    with closing(open_hub(run, endpoint, credentials, certificate)) as bus:
        relay(bus, run, settings, reply_timeout_s, pause_s, waits=False, captures=captures)


def relay(
    bus: Bus,
    run: str,
    settings: RadioSettings,
    reply_timeout_s: float,
    pause_s: float = 0.0,
    tell: Callable[[str], object] = lambda _: None,
    *,
    waits: bool = True,
    captures: bool = True,
) -> None:
    """Serve as the relay at an open hub until all participants have left; `tell` is called with those missing.

    Who has not joined yet is waited for as long as it takes if it `waits`; else the run is broken off once nobody has
    joined for as long as a robot may take for anything. `pause_s` is the world's pause between steps at most.
    """
    node = RelayNode(bus, Keys(run), settings, captures=captures)
    reply_timeout = ReplyTimeout(node, reply_timeout_s)
    told: list[str] = []
    while not node.done:
        message = bus.receive(POLL_S)
        if message is not None:
            node.handle(message)
        idle = reply_timeout.look()
        if node.going_home and idle > FAREWELL_S:
            break
        missing = node.missing()
        if missing and idle > reply_timeout_s and not waits:
            node.break_off(f"{', '.join(missing)} did not join within {reply_timeout_s:g} s")
        if not missing and idle > silence_s(reply_timeout_s, pause_s) and not node.waiting_for():
            node.break_off(f"the world said nothing for {idle:.0f} s")
        if missing != told:
            told = missing
            tell(f"waiting for {', '.join(told)}" if told else "all are here")


def silence_s(reply_timeout_s: float, pause_s: float) -> float:
    """For how long a world may say nothing: it waits for robots itself."""
    return 2 * reply_timeout_s + pause_s


def serve_world(credential: Credential, task: WorldTask, wrap: Wrap | None = None) -> None:
    """Serve as the world of a run."""
    bus = _joined(credential, wrap)
    keys = Keys(credential.run)
    node = WorldNode(
        bus,
        keys,
        task.world,
        task.steps,
        task.cell_mm,
        wait=task.wait,
        revive=task.revive,
        incarnations=task.incarnations,
    )
    _serve(bus, node, ReplyTimeout(node, task.reply_timeout_s))


def serve_router(credential: Credential, endpoint: str, credentials: Mapping[str, Credential]) -> None:
    """Serve as the router of a host's robots, who show it `credentials`, until the hub is gone."""
    with closing(Router(credential, endpoint, credentials)) as router:
        router.serve()


def wait_for_a_turn() -> None:
    """Have a process that is woken wait until a processor is free, where the system can tell (Linux).

    Robots outnumber processors, and all are woken at once: each would interrupt the relay while it hands out what
    the others wait for. To be called before zenoh first opens, for its threads to do likewise.
    """
    with suppress(AttributeError, OSError):
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def serve_agent(credential: Credential, journal: Path | None = None, wrap: Wrap | None = None) -> None:
    """Serve as one robot of a run; with a `journal` it may be killed and begin again."""
    kept = Journal.open(journal) if journal is not None else None
    wait_for_a_turn()
    bus = _joined(credential, wrap)
    node = AgentNode(bus, Keys(credential.run), names.number(credential.name), kept)
    try:
        _serve(bus, node)
    except JournalError as error:
        sys.exit(f"{journal}: {error}")


def serve_view(credential: Credential, task: ViewTask, ready: Connection) -> None:
    """Serve as the viewer of a run, which only listens; tell `ready` once it does."""
    from deploy.dashboard import process  # noqa: PLC0415  only the viewer needs its imports

    process.serve(credential, task, lambda: ready.send(True))


def _joined(credential: Credential, wrap: Wrap | None) -> Bus:
    if credential.certificate is None:
        send_along()
    bus = join(credential)
    return bus if wrap is None else wrap(credential.name, bus)


def _serve(bus: Bus, node: WorldNode | AgentNode, reply_timeout: ReplyTimeout | None = None) -> None:
    try:
        while not node.done:
            message = bus.receive(None if reply_timeout is None else POLL_S)
            if message is not None:
                node.handle(message)
            if reply_timeout is not None:
                reply_timeout.look()
        if isinstance(node, AgentNode) and node.killed:
            os.kill(os.getpid(), signal.SIGKILL)
    finally:
        bus.close()


def in_background(name: str, log: Path, serve: Callable[..., None], *args: object) -> None:
    """Run `serve` as a child of the launcher: its output goes to `log`; Ctrl-C is handled by the launcher."""
    setproctitle(f"murmur {name}")
    parent_watchdog.end_with_launcher()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    except FileNotFoundError:
        sys.exit(BROKEN_OFF)  # the launcher has gone, and taken the folder with it
    os.dup2(file, 1)
    os.dup2(file, 2)
    try:
        serve(*args)
    except (BusClosed, ConnectionError) as error:
        print(error, file=sys.stderr)
        sys.exit(BROKEN_OFF)
    except Exception as error:
        print(traceback_of(error), file=sys.stderr)
        sys.exit(1)
