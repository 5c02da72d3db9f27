"""The child processes of one run on this host: started by one fork server, supervised, and ended.

Children start with the code imported and the kernels loaded, before any bus is opened. A child that ends
prematurely is reported with its name and crash report; none outlives the table.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import time
import types
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from typing import Self

from deploy.run import parent_watchdog
from deploy.run.crash_report import crash_report
from deploy.run.processes import BROKEN_OFF, in_background

FORK_SERVER = "the fork server"
UNKNOWN = 255
"""Exit code of a child whose fork server has died."""
GRACE_S = 1.0
"""Time limit for a child to end by itself before it is terminated, and then killed."""


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


class ProcessTable:
    """A run's children; a context manager that leaves none behind."""

    def __init__(self, logs: Path) -> None:
        self.deaths: dict[str, str] = {}
        """Children that ended prematurely, each with its crash report; `check` updates it."""
        self._logs = logs
        self._children: list[Child] = []
        self._context = multiprocessing.get_context("forkserver")
        self._context.set_forkserver_preload(["deploy.run.parent_watchdog", "deploy.run.preload"])

    def __enter__(self) -> Self:
        self._logs.mkdir(parents=True, exist_ok=True)
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def start(self, name: str, serve: Callable[..., None], *args: object, needed: bool = True) -> None:
        """Start a child that runs ``serve(*args)``; its output goes to ``NAME.log``."""
        log = self._logs / f"{name}.log"
        with _blank_main():
            process = self._context.Process(target=in_background, args=(name, log, serve, *args), name=name)
            os.environ[parent_watchdog.FOLDER] = parent_watchdog.open_folder()
            try:
                process.start()
            except (EOFError, ConnectionError):
                raise ConnectionError(f"{FORK_SERVER} died before it had started {name}") from None
            finally:
                del os.environ[parent_watchdog.FOLDER]
        self._children.append(Child(name, process, log, needed))

    def give_up(self, name: str) -> None:
        """Kill a child; its end is not an error."""
        for child in self._children:
            if child.name == name and child.needed and name not in self.deaths:
                child.needed = False
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
        if dead and all(child.process.exitcode == UNKNOWN and not child.has_output for child in dead):
            self.deaths.setdefault(FORK_SERVER, "the exit codes of its processes are unknown")
            return self.deaths
        for child in dead:
            if child.name not in self.deaths:
                self.deaths[child.name] = child.crash_report()
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
        for child in self._children:
            if child.log.exists() and not child.log.stat().st_size:
                child.log.unlink()
        if self._logs.exists() and not any(self._logs.iterdir()):
            self._logs.rmdir()


@contextlib.contextmanager
def _blank_main() -> Iterator[None]:
    """Hide the main module, which children would otherwise import again."""
    main = sys.modules["__main__"]
    sys.modules["__main__"] = types.ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main
