"""A robot's own work when its memory is cold, as it is where eight processes take turns on two cores.

What a robot hears in a run is recorded, and heard again by one robot alone: message by message, and then with so much
read between two messages as drives what the robot needs out of the processor's caches.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from agent.process import AgentNode
from deploy.bench.ratios import Figure, compare
from deploy.bench.swarm import CASES, REPEATS, plan_of
from deploy.run import in_memory
from deploy.run.garbage import seldom_looking
from deploy.scenario.plan import Plan
from protocol import keys as names
from protocol.bus import Bus, Message
from protocol.keys import Keys

BETWEEN = 32 << 20
"""Bytes that are read between two messages."""
LINE = 64
"""Bytes of which reading one brings all into the caches."""


def cold() -> Iterator[Figure]:
    """One robot of eight: its work a step, warm and cold."""
    block = np.zeros(BETWEEN, np.uint8)[::LINE]
    for case in CASES:
        ear, steps = overheard(plan_of(case))
        hear_again(ear.heard)  # loads what the first messages need
        warm, chilled = [], []
        for _ in range(REPEATS):
            warm.append(1000 * hear_again(ear.heard).seconds / steps)
            chilled.append(1000 * hear_again(ear.heard, block.sum).seconds / steps)
        what = f"a robot's work a step, {case.exchange}"
        yield Figure(f"{what}, warm", "ms", float(np.median(warm)))
        yield compare(f"{what}, cold", "ms", chilled, "the same, warm", warm)


@dataclass
class Ear:
    """A robot's end of a bus that keeps what it hears, and counts what it says; without a bus nobody hears that.

    Attributes
    ----------
    seconds : float
        What the robot took for all messages, where that is measured.
    """

    inner: Bus | None = None
    heard: list[Message] = field(default_factory=list)
    said: int = 0
    seconds: float = 0.0

    def put(self, key: str, payload: bytes) -> None:
        """Count what is said, and pass it on."""
        self.said += 1
        if self.inner is not None:
            self.inner.put(key, payload)

    def receive(self, timeout_s: float | None = None) -> Message | None:
        """Keep what is heard."""
        message = self.inner.receive(timeout_s) if self.inner is not None else None
        if message is not None:
            self.heard.append(message)
        return message

    def close(self) -> None:
        """Leave the bus."""
        if self.inner is not None:
            self.inner.close()


def overheard(plan: Plan) -> tuple[Ear, int]:
    """Run a plan in memory; return what robot 0 heard, and how many steps it took."""
    ears: dict[str, Ear] = {}

    def listen(name: str, bus: Bus) -> Bus:
        ears[name] = Ear(bus)
        return ears[name]

    records = in_memory.run(plan, wrap=listen)
    return ears[names.robot(0)], records.step


def hear_again(heard: list[Message], between: Callable[[], object] = lambda: None) -> Ear:
    """Have a robot alone hear all messages, with something done between them that is not measured."""
    ear = Ear()
    node = AgentNode(ear, Keys("bench"), 0)
    with seldom_looking():
        for message in heard:
            between()
            began = time.perf_counter()
            node.handle(message)
            ear.seconds += time.perf_counter() - began
    return ear
