"""The viewer process: it receives the reports of a run over the bus, records them and serves the recording.

No participant waits for it. Messages that it cannot receive in time are dropped (`protocol.keys.may_be_dropped`); if it
hangs or dies, the run is not affected.
"""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path

from deploy.scenario.plan import Plan
from protocol import keys as names
from protocol import rights
from protocol.bus import BusClosed, Message
from protocol.errors import ProtocolError
from protocol.message_fields import clip
from protocol.messages import ErrorReport, Shutdown
from protocol.signals import ending_signals, handled
from protocol.zenoh_bus import Credential, join

RECORDING = "run.rrd"
LAST_S = 0.2
"""Silence after the end of the run before the viewer stops: the relay's last message can overtake those of robots."""

TICK_S = 0.25
"""How often a viewer that receives nothing checks whether it was asked to stop."""


@dataclass(frozen=True)
class ViewTask:
    """The task of a viewer."""

    plan: Plan
    directory: Path
    """The run directory, for the recording."""
    port: int | None = None
    """Port on the loopback at which viewers get the recording while it is made."""


class ViewNode:
    """The viewer's end of the bus; it passes each sender and report to `take`, and is `done` once the run is over."""

    def __init__(self, take: Callable[[str, object], object]) -> None:
        self.done = False
        self.take = take

    def handle(self, message: Message) -> None:
        """Process one message from the bus; show a malformed one as a protocol error of its sender."""
        sender = names.parts(message.key)[3]
        try:
            self._show(sender, rights.read(*message))
        except ProtocolError as error:
            self._show(sender, ErrorReport(sender, clip(str(error))))

    def _show(self, sender: str, report: object) -> None:
        if isinstance(report, Shutdown):
            self.done = True
        self.take(sender, report)


@contextlib.contextmanager
def watching(task: ViewTask) -> Iterator[ViewNode]:
    """Open the recording; close it at the end, however the run ends."""
    from deploy.dashboard.recording import recording  # noqa: PLC0415  only recording needs Rerun

    with recording(task.plan, free_name(task.directory / RECORDING), task.port) as recorder:
        yield ViewNode(recorder.take)


def serve(credential: Credential, task: ViewTask, ready: Callable[[], object] = lambda: None) -> bool:
    """View a run until it is over, the hub is gone, SIGTERM, SIGHUP or Ctrl-C; call `ready` once on the bus.

    Return whether the run ended by itself.
    """
    asked: list[int] = []
    # A child of the launcher keeps ignoring Ctrl-C and SIGHUP.
    obeyed = [number for number in ending_signals() if signal.getsignal(number) != signal.SIG_IGN]
    with handled(obeyed, lambda number, _: asked.append(number)), watching(task) as node:
        bus = join(credential)
        try:
            ready()
            while not asked:
                message = bus.receive(LAST_S if node.done else TICK_S)
                if message is not None:
                    node.handle(message)
                elif node.done:
                    break
        except BusClosed as error:
            if not node.done:
                print(f"{error}; the recording until then is kept", file=sys.stderr)
        finally:
            bus.close()
    return not asked


def free_name(path: Path) -> Path:
    """The path, with a number appended if the file already exists."""
    numbered = (path.with_stem(f"{path.stem}-{number}") for number in count(2))
    return next(free for free in chain([path], numbered) if not free.exists())
