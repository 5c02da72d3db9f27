"""An upper bound of a swarm's speed: its own traffic, message by message, without any computation.

A run on the memory bus is recorded: after how many received messages each participant puts what. On Zenoh
the same processes then play this script, with payloads of the same sizes, and do nothing else.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from deploy.record.records import Records
from deploy.run import in_memory
from deploy.run.processes import FAREWELL_S, wait_for_a_turn
from deploy.scenario.plan import Plan
from netshaper.hub import open_hub
from protocol import keys as names
from protocol.bus import Bus, Message
from protocol.keys import Keys
from protocol.zenoh_bus import Credential, join, send_along


@dataclass
class Script:
    """What one participant does: after `after` received messages it puts `(key, size)`s, in this order."""

    cues: list[tuple[int, list[tuple[str, int]]]] = field(default_factory=list)
    total: int = 0
    """Messages that it receives in total."""


@dataclass
class _Recorder:
    """A bus end that records what passes through it."""

    inner: Bus
    script: Script = field(default_factory=Script)

    def put(self, key: str, payload: bytes) -> None:
        cues = self.script.cues
        if not cues or cues[-1][0] != self.script.total:
            cues.append((self.script.total, []))
        cues[-1][1].append((key, len(payload)))
        self.inner.put(key, payload)

    def receive(self, timeout_s: float | None = None) -> Message | None:
        message = self.inner.receive(timeout_s)
        if message is not None and names.parts(message.key)[0] != "presence":
            self.script.total += 1
        return message

    def close(self) -> None:
        self.inner.close()


def record(plan: Plan) -> tuple[dict[str, Script], Records]:
    """Run a plan in memory; return everyone's script, and the run's records."""
    recorders: dict[str, _Recorder] = {}

    def listen(name: str, bus: Bus) -> Bus:
        recorders[name] = _Recorder(bus)
        return recorders[name]

    records = in_memory.run(plan, wrap=listen)
    return {name: recorder.script for name, recorder in recorders.items()}, records


def play_hub(
    run: str, endpoint: str, credentials: dict[str, Credential], clients: int, script: Script
) -> None:
    """Play the relay's script, after waiting for the given number of clients."""
    bus = open_hub(run, endpoint, credentials)
    try:
        here: set[str] = set()
        while len(here) < clients:
            message = bus.receive()
            if message is not None and names.parts(message.key)[0] == "presence":
                here.add(message.key)
        _play(bus, Keys(run), script)
        deadline = time.monotonic() + FAREWELL_S
        while time.monotonic() < deadline and here:
            message = bus.receive(0.5)
            if message is not None and message.payload == b"0":
                here.discard(message.key)
    finally:
        bus.close()


def play(credential: Credential, script: Script) -> None:
    """Play the script of any other participant."""
    if names.is_robot(credential.name):
        wait_for_a_turn()
    send_along()
    bus = join(credential)
    try:
        _play(bus, Keys(credential.run), script)
    finally:
        bus.close()


def play_recorder(credential: Credential, script: Script, check: Callable[[], object]) -> float:
    """Play the laboratory's script; return the seconds from the first to the last message."""
    bus = join(credential)
    try:
        return _play(bus, Keys(credential.run), script, check)
    finally:
        bus.close()


def _play(bus: Bus, keys: Keys, script: Script, check: Callable[[], object] = lambda: None) -> float:
    received = 0
    began = 0.0
    cues = [(after, [(_rekey(key, keys), bytes(size)) for key, size in puts]) for after, puts in script.cues]
    cues.append((script.total, []))
    for after, puts in cues:
        while received < after:
            message = bus.receive(1.0)
            if message is None:
                check()
            elif names.parts(message.key)[0] != "presence":
                began = began or time.perf_counter()
                received += 1
        for key, payload in puts:
            bus.put(key, payload)
    return time.perf_counter() - began


def _rekey(key: str, keys: Keys) -> str:
    """The same key in another run."""
    root, _, *rest = key.split("/")
    return "/".join([root, keys.run, *rest])
