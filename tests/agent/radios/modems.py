"""Frame modems, played by pseudo-terminals: a test has one side of each, robots open the other."""

from __future__ import annotations

import contextlib
import os
import threading
import time
import tty
from collections.abc import Iterator
from pathlib import Path

from agent.radios.cobs import LineReader, line
from protocol.keyed_random import keyed_random
from protocol.nanoseconds import SECOND

LONGEST = 222
"""Bytes of the longest frame."""
RATE = 200
"""Bytes per second that all modems together carry."""
TICK_S = 0.01


class Terminal:
    """A pseudo-terminal: robots open its `path`, and the test has the other side."""

    def __init__(self) -> None:
        self.side, terminal = os.openpty()
        tty.setraw(self.side)
        os.set_blocking(self.side, False)
        self.path = Path(os.ttyname(terminal))
        os.close(terminal)

    def read(self) -> bytes:
        with contextlib.suppress(OSError):  # EIO while no process has the terminal open
            return os.read(self.side, 1 << 16)
        return b""


class Modems:
    """Modems that carry frames between terminals at `RATE`, half duplex, and lose a share of them."""

    def __init__(self, robots: int, loss: float) -> None:
        self.terminals = [Terminal() for _ in range(robots)]
        self.frames = self.lost = 0
        self._loss = loss
        self._readers = [LineReader(LONGEST) for _ in range(robots)]
        self._on_air: list[tuple[int, int, bytes]] = []
        """When each frame ends, its sender, and the frame."""
        self._free = 0

    def carry(self, now: int) -> None:
        for number, terminal in enumerate(self.terminals):
            for frame in self._readers[number].feed(terminal.read()):
                self._free = max(self._free, now) + len(frame) * SECOND // RATE
                self._on_air.append((self._free, number, frame))
        while self._on_air and self._on_air[0][0] <= now:
            _, sender, frame = self._on_air.pop(0)
            self.frames += 1
            for receiver, terminal in enumerate(self.terminals):
                if receiver != sender:
                    if keyed_random(1, "modem", self.frames, receiver).random() < self._loss:
                        self.lost += 1
                    else:
                        with contextlib.suppress(BlockingIOError):  # no process reads
                            os.write(terminal.side, line(frame))

    def close(self) -> None:
        for terminal in self.terminals:
            os.close(terminal.side)


@contextlib.contextmanager
def carrying(modems: Modems) -> Iterator[None]:
    """Let modems carry frames in real time, on a thread; close them at the end."""
    over = threading.Event()

    def carry() -> None:
        while not over.wait(TICK_S):
            modems.carry(time.monotonic_ns())

    thread = threading.Thread(target=carry, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        modems.close()
