"""The child processes of one run on this host: started by the fork server, supervised, and ended.

Children start with the code imported and the kernels loaded, before any bus is opened. A child that ends
prematurely is reported with its name and crash report; none outlives the table.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from typing import Self

from deploy.run import fork_server, parent_watchdog
from deploy.run.crash_report import crash_report
from deploy.run.exit_codes import BROKEN_OFF
from deploy.run.processes import in_background
from deploy.run.reply_timeout import CHECK_S, REPLY_TIMEOUT_S, RunningClock
from protocol import keys as names

FORK_SERVER = "the fork server"
UNKNOWN = 255
"""Exit code of a child whose fork server has died."""
_AWAITED = (names.RELAY, names.WORLD)
GRACE_S = 1.0
"""Time limit for a child to end by itself before it is terminated, and then killed."""

PRINTING_S = 0.2
"""Time limit for a child that hangs to print the place in its code."""


@dataclass
class Child:
    """One row of the process table."""

    name: str
    process: ForkServerProcess
    log: Path
    needed: bool = True
    """Whether its premature end is an error."""

    @property
    def has_output(self) -> bool:
        """Whether it has printed anything."""
        return self.log.exists() and self.log.stat().st_size > 0

    def crash_report(self) -> str:
        """Return how it ended, and its traceback or last line of output."""
        code = self.process.exitcode
        how = f"exit code {code}"
        if code is not None and code < 0:
            how = f"killed by {signal.Signals(-code).name}"
        output = crash_report(self.log.read_text(errors="replace")) if self.log.exists() else ""
        return f"{how}; last output: {output}" if output else f"{how}, no output"


def load_fork_server() -> None:
    """Start the fork server, and wait until it has loaded the kernels, which it compiles at the first use.

    All runs of this process share it. If it fails, the run reports that. KeyboardInterrupt ends it.

    Raises ValueError if this process may not have children.
    """
    fork_server.check_process()
    if fork_server.pid() is not None:
        return
    logs = Path(parent_watchdog.open_folder()) / "preload"
    with contextlib.suppress(ConnectionError), ProcessTable(logs) as table:
        try:
            table.start("preload", _do_nothing, needed=False)
        except KeyboardInterrupt:
            if (pid := fork_server.pid()) is not None:
                os.kill(pid, signal.SIGKILL)
            raise


def _do_nothing() -> None:
    """Serve as nothing: a child that starts once the fork server has loaded its modules."""


class ProcessTable:
    """A run's children; a context manager that leaves none behind.

    Relay, world or fork server, for which all others wait, are killed if they are stopped (SIGSTOP) for half of
    `reply_timeout_s`: before the relay or the world would hold their silence against the robots.
    """

    def __init__(self, logs: Path, reply_timeout_s: float = REPLY_TIMEOUT_S) -> None:
        self.deaths: dict[str, str] = {}
        """Children that ended prematurely, each with its crash report; `check` updates it."""
        self._logs = logs
        self._stopped_s = reply_timeout_s / 2
        self._killed: dict[str, str] = {}
        """Why processes were killed that did not answer, by name."""
        self._ended = threading.Event()
        self._children: list[Child] = []
        self._context = fork_server.context()

    def __enter__(self) -> Self:
        self._logs.mkdir(parents=True, exist_ok=True)
        threading.Thread(target=self._watch, name="stopped processes", daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def start(self, name: str, serve: Callable[[], None], *, needed: bool = True) -> None:
        """Start a child that runs `serve`, which must be picklable; its output goes to ``NAME.log``.

        Raises ConnectionError if the fork server dies, or cannot start another process.
        """
        log = self._logs / f"{name}.log"
        process = self._context.Process(target=in_background, args=(name, log, serve), name=name)
        try:
            with fork_server.starting():
                process.start()
        except (EOFError, ConnectionError):
            why = self._killed.get(FORK_SERVER, "it ended")
            raise ConnectionError(f"{why}, before it had started {name}") from None
        except OSError as error:
            raise ConnectionError(f"cannot start {name}: {error.strerror}") from None
        self._children.append(Child(name, process, log, needed))

    def give_up(self, name: str, *, hangs: bool = False) -> None:
        """Kill a child; its end is not an error. A child that `hangs` first prints the place in its code."""
        for child in self._children:
            if child.name == name and child.needed and name not in self.deaths:
                child.needed = False
                if hangs and child.process.pid is not None:
                    os.kill(child.process.pid, signal.SIGUSR1)
                    child.process.join(PRINTING_S)
                child.process.kill()

    def excuse(self, name: str) -> None:
        """Note that a child is expected to end prematurely."""
        for child in self._children:
            if child.name == name:
                child.needed = False
        self.deaths.pop(name, None)

    def check(self) -> dict[str, str]:
        """Check the children; return all premature ends so far."""
        dead = [child for child in self._children if child.needed and child.process.exitcode not in (None, 0)]
        if FORK_SERVER in self._killed:
            self.deaths.setdefault(FORK_SERVER, self._killed[FORK_SERVER])
            return self.deaths
        if dead and all(child.process.exitcode == UNKNOWN and not child.has_output for child in dead):
            self.deaths.setdefault(FORK_SERVER, "the exit codes of its processes are unknown")
            return self.deaths
        for child in dead:
            if child.name not in self.deaths:
                self.deaths[child.name] = self._killed.get(child.name) or child.crash_report()
        return self.deaths

    def forget_disconnected(self) -> None:
        """Remove the children from `deaths` that ended because the hub had ended."""
        for child in self._children:
            if child.process.exitcode == BROKEN_OFF:
                self.deaths.pop(child.name, None)

    def ended(self) -> dict[str, int]:
        """Return the children that have ended, with their exit codes; negative: killed by this signal."""
        codes = {child.name: child.process.exitcode for child in self._children}
        return {name: code for name, code in codes.items() if code is not None}

    def await_end(self, name: str, timeout_s: float) -> str:
        """Wait for a child to end by itself; return its error, or an empty text."""
        child = next((child for child in self._children if child.name == name), None)
        if child is None:
            return "it runs on another host"
        child.process.join(timeout_s)
        if child.process.exitcode is None:
            return f"it did not end within {timeout_s:g} s"
        return child.crash_report() if child.process.exitcode else ""

    def end(self) -> None:
        """End all children: wait, terminate, then kill. Remove empty logs."""
        for act in (lambda _: None, ForkServerProcess.terminate, ForkServerProcess.kill):
            deadline = time.monotonic() + GRACE_S
            for child in self._children:
                if child.process.is_alive():
                    act(child.process)
            for child in self._children:
                child.process.join(max(0.0, deadline - time.monotonic()))
        self._ended.set()
        if any(child.process.is_alive() for child in self._children):
            self._kill(FORK_SERVER, fork_server.pid(), "it did not report the ends of its processes")
            self.check()
        for child in self._children:
            if child.process.exitcode == UNKNOWN and child.process.pid is not None:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(child.process.pid, signal.SIGKILL)
        for child in self._children:
            if child.log.exists() and not child.log.stat().st_size:
                child.log.unlink()
        if self._logs.exists() and not any(self._logs.iterdir()):
            self._logs.rmdir()

    def _watch(self) -> None:
        """Kill the fork server, the relay or the world once it has been stopped for too long (a thread)."""
        clock = RunningClock()
        since: dict[str, float] = {}
        while not self._ended.wait(min(CHECK_S, self._stopped_s / 4)):
            now = clock()
            pids = {FORK_SERVER: fork_server.pid()}
            pids |= {child.name: child.process.pid for child in self._children if child.name in _AWAITED}
            for name, pid in pids.items():
                if name in self._killed or not _is_stopped(pid):
                    since.pop(name, None)
                elif now - since.setdefault(name, now) > self._stopped_s:
                    self._kill(name, pid, f"it was stopped for {self._stopped_s:g} s, and was killed")

    def _kill(self, name: str, pid: int | None, reason: str) -> None:
        """Kill a process that does not answer, so that nothing waits for it."""
        self._killed[name] = reason
        if pid is not None:
            os.kill(pid, signal.SIGKILL)


def _is_stopped(pid: int | None) -> bool:
    """Return whether a process is stopped, by SIGSTOP or a debugger; False where the system does not tell."""
    try:
        status = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False
    return status.rpartition(")")[2].split()[0] in ("T", "t")
