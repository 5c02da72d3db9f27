"""Benchmark of the relay: processing time per frame, from the received message to ledger and capture, without a bus.

The benchmark records the messages that the relay receives during a run in memory, and replays them to a new relay. The
baseline only parses the packets of the same frames (`protocol.packet_codec.decode`).
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from functools import partial
from typing import Any

from deploy.bench.explorations import office_plan
from deploy.bench.measurement import Measurement, compare, timed
from deploy.run.recording_bus import RecordingBus, record_run
from deploy.scenario.plan import Plan
from netshaper.process import RelayNode
from protocol import keys as names
from protocol import packet_codec, rights
from protocol.bus import Message
from protocol.errors import ProtocolError
from protocol.keys import Keys

STEPS = 60
REPEATS = 5


CASES: tuple[dict[str, Any], ...] = (
    {"robots": 8, "map_encoding": "polygons", "bandwidth": 1000},
    {"robots": 8, "map_encoding": "scans", "bandwidth": "unlimited"},
    {"robots": 32, "map_encoding": "polygons", "bandwidth": 1000},
)


def relay() -> Iterator[Measurement]:
    """Measure the relay's processor time per frame in microseconds."""
    for case in CASES:
        plan = office_plan(steps=STEPS, bus="memory", **case)
        received = record_run(plan, [names.RELAY])[names.RELAY]
        radio = [rights.read(*message) for message in received if names.parts(message.key)[0] == "radio"]
        frames = [frame.payload for message in radio for frame in message.frames]
        frames += [message.broadcast for message in radio if message.broadcast]
        relaying, decoding = [], []
        for _ in range(REPEATS):
            relaying.append(1000 * timed(partial(_relay, plan, received))[1] / len(frames))
            decoding.append(1000 * timed(partial(_decode, frames))[1] / len(frames))
        name = f"relay, {case['robots']} robots, {case['map_encoding']}, {case['bandwidth']}: time per frame"
        yield compare(name, "us", relaying, "parsing its packets", decoding)


def _relay(plan: Plan, received: list[Message]) -> None:
    node = RelayNode(RecordingBus(), Keys("memory"), plan.radio)
    for message in received:
        node.handle(message)


def _decode(frames: list[bytes]) -> None:
    for frame in frames:
        with contextlib.suppress(ProtocolError):
            packet_codec.decode(frame)
