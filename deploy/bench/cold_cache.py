"""A robot's own work when its memory is cold, as it is where eight processes take turns on two cores.

What a robot hears in a run is recorded, and heard again by one robot alone: message by message, and then with so much
read between two messages as drives what the robot needs out of the processor's caches.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import numpy as np

from agent.process import AgentNode
from deploy.bench.ratios import Figure, compare
from deploy.bench.recording_bus import RecordingBus, recorded_for
from deploy.bench.swarm import CASES, REPEATS, plan_of
from deploy.run.garbage import seldom_looking
from protocol import keys as names
from protocol.bus import Message
from protocol.keys import Keys

BETWEEN = 32 << 20
"""Bytes that are read between two messages."""
LINE = 64
"""Bytes of which reading one brings all into the caches."""


def cold_cache() -> Iterator[Figure]:
    """One robot of eight: its work a step, warm and cold."""
    block = np.zeros(BETWEEN, np.uint8)[::LINE]
    for case in CASES:
        recording_bus, steps = recorded_for(plan_of(case), names.robot(0))
        hear_again(recording_bus.heard)  # loads what the first messages need
        warm, chilled = [], []
        for _ in range(REPEATS):
            warm.append(1000 * hear_again(recording_bus.heard)[0] / steps)
            chilled.append(1000 * hear_again(recording_bus.heard, block.sum)[0] / steps)
        what = f"a robot's work a step, {case.map_encoding}"
        yield Figure(f"{what}, warm", "ms", float(np.median(warm)))
        yield compare(f"{what}, cold", "ms", chilled, "the same, warm", warm)


def hear_again(heard: list[Message], between: Callable[[], object] = lambda: None) -> tuple[float, int]:
    """Have a robot alone hear all messages, with something done between them that is not measured.

    Return the seconds that it takes, and how many messages it says.
    """
    recording_bus, seconds = RecordingBus(), 0.0
    node = AgentNode(recording_bus, Keys("bench"), 0)
    with seldom_looking():
        for message in heard:
            between()
            began = time.perf_counter()
            node.handle(message)
            seconds += time.perf_counter() - began
    return seconds, recording_bus.said
