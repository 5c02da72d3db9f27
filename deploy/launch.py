"""A run as processes: relay, world and robots from one fork server, the laboratory in this process.

One table says what runs; all of it starts at once and meets at the hub; nothing sleeps. What ends before its
time is reported by name and last words.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import secrets
import signal
import socket
import sys
import tempfile
import time
import types
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.context import ForkServerProcess
from pathlib import Path

from deploy.plan import Plan
from deploy.processes import WorldTask, in_background, serve_agent, serve_relay, serve_world
from deploy.records import LabNode, Records
from netshaper import access
from protocol import keys as names
from protocol.bus import BusClosed
from protocol.keys import Keys
from protocol.zenoh_bus import join

POLL_S = 0.25
WRAP_UP_S = 3.0
"""How long the others may take to hand in what they have, once the run is over or was interrupted."""
GRACE_S = 1.0
"""How long a child may take to end by itself before it is terminated, and then killed."""


@dataclass
class Child:
    """One row of the process table."""

    name: str
    process: ForkServerProcess
    log: Path
    reported: bool = False

    def last_words(self) -> str:
        """How it ended and the last line that it wrote."""
        code = self.process.exitcode
        how = f"exit code {code}"
        if code is not None and code < 0:
            how = f"killed by {signal.Signals(-code).name}"
        lines = self.log.read_text(errors="replace").split("\n") if self.log.exists() else []
        said = [line.strip() for line in lines if line.strip()]
        return f"{how}; its last words: {said[-1]}" if said else f"{how}, without a word"


@dataclass
class Outcome:
    """What a launch brought: the records, and what went wrong, by process."""

    records: Records
    deaths: dict[str, str]
    interrupted: bool = False


def run(plan: Plan, logs: Path | None, watch: Callable[[Records], object] | None = None) -> Outcome:
    """Run a plan as processes; `watch` is called as records come in, at most a few times a second.

    What the processes print goes to files in `logs`, or is gone after the run if that is None.
    """
    if logs is None:
        with tempfile.TemporaryDirectory() as folder:
            return run(plan, Path(folder), watch)
    robots = plan.scenario.robots
    run_id = secrets.token_hex(4)
    endpoint = f"tcp/127.0.0.1:{_free_port()}"
    credentials = access.issue(run_id, endpoint, robots)
    logs.mkdir(parents=True, exist_ok=True)
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["deploy.processes"])
    world = WorldTask(plan.make_world(), plan.minds, plan.scenario.steps, 1000 * plan.map.resolution)
    table: dict[str, tuple[object, ...]] = {
        names.RELAY: (serve_relay, run_id, endpoint, credentials, plan.radio),
        names.WORLD: (serve_world, credentials[names.WORLD], world),
    }
    for name in map(names.robot, range(robots)):
        table[name] = (serve_agent, credentials[name])
    children: list[Child] = []
    with _interrupts() as interrupted:
        try:
            with _blank_main():
                for name, (serve, *args) in table.items():
                    log = logs / f"{name}.log"
                    process = context.Process(target=in_background, args=(name, log, serve, *args), name=name)
                    process.start()
                    children.append(Child(name, process, log))
            return _attend(credentials[names.LAB], robots, children, interrupted, watch)
        finally:
            _end(children)


def _attend(
    credential: access.Credential,
    robots: int,
    children: list[Child],
    interrupted: list[int],
    watch: Callable[[Records], object] | None,
) -> Outcome:
    """Be the laboratory until the run is over."""
    deaths: dict[str, str] = {}
    records = Records(robots)
    try:
        bus = join(credential)
    except ConnectionError as error:
        _report_deaths(children, deaths)
        deaths.setdefault(names.RELAY, str(error))
        return Outcome(records, deaths)
    lab = LabNode(bus, Keys(credential.run), robots)
    deadline = float("inf")
    asked_to_stop = False
    looked = 0.0
    try:
        while not lab.done:
            message = bus.receive(POLL_S)
            if message is not None:
                lab.handle(message)
            now = time.monotonic()
            if now - looked < POLL_S:
                continue
            looked = now
            if watch is not None:
                watch(lab.records)
            _report_deaths(children, deaths)
            if interrupted and not asked_to_stop:
                asked_to_stop = True
                lab.stop("interrupted")
                deadline = now + WRAP_UP_S
            if (lab.records.end is not None or names.WORLD in deaths) and deadline == float("inf"):
                deadline = now + WRAP_UP_S
            if now > deadline or len(interrupted) > 1 or not _can_begin(lab.records, deaths):
                lab.send_home()
    except BusClosed as error:
        time.sleep(POLL_S)
        _report_deaths(children, deaths)
        deaths.setdefault(names.RELAY, str(error))
    finally:
        bus.close()
    _report_deaths(children, deaths)
    return Outcome(lab.records, deaths, bool(interrupted))


def _can_begin(records: Records, deaths: dict[str, str]) -> bool:
    """Whether a first step can still come: not if someone died before it."""
    return bool(records.world) or not deaths


def _report_deaths(children: list[Child], deaths: dict[str, str]) -> None:
    for child in children:
        if not child.reported and child.process.exitcode not in (None, 0):
            child.reported = True
            deaths[child.name] = child.last_words()


def _end(children: list[Child]) -> None:
    """Wait, terminate, kill: no child outlives the run."""
    for act in (lambda _: None, ForkServerProcess.terminate, ForkServerProcess.kill):
        deadline = time.monotonic() + GRACE_S
        for child in children:
            if child.process.is_alive():
                act(child.process)
        for child in children:
            child.process.join(max(0.0, deadline - time.monotonic()))
    for child in children:
        if child.log.exists() and not child.log.stat().st_size:
            child.log.unlink()
    if children and not any(children[0].log.parent.iterdir()):
        children[0].log.parent.rmdir()


@contextlib.contextmanager
def _interrupts() -> Iterator[list[int]]:
    """Collect Ctrl-C and SIGTERM in a list instead of dying of them (in the main thread)."""
    caught: list[int] = []
    before = {}
    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            before[number] = signal.signal(number, lambda signum, _: caught.append(signum))
    except ValueError:
        before = {}  # not the main thread: signals are its affair
    try:
        yield caught
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def _blank_main() -> Iterator[None]:
    """Hide the main module, which children would import again, command line and all."""
    main = sys.modules["__main__"]
    sys.modules["__main__"] = types.ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


def _free_port() -> int:
    """A port of the loopback that nobody listens to now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
