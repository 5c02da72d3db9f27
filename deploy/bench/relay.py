"""Benchmark of the relay: processing time per frame, from the received message to ledger and capture, without a bus.

The benchmark records the messages that the relay receives during a run in memory, and replays them to a new relay. The
baseline only parses the packets of the same frames (`protocol.packets.decode`).
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Literal

from deploy.bench.measurement import Measurement, compare, timed
from deploy.run.recording_bus import RecordingBus, record_run
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import Scenario
from netshaper.process import RelayNode
from protocol import keys as names
from protocol import packets, rights
from protocol.bus import Message
from protocol.errors import ProtocolError
from protocol.keys import Keys
from worldsim import generators

STEPS = 60
REPEATS = 5
SIDE_M = 30.0


@dataclass(frozen=True)
class Case:
    """The settings of one measured team."""

    robots: int
    map_encoding: str
    bandwidth: int | Literal["unlimited"]


CASES = (Case(8, "polygons", 1000), Case(8, "scans", "unlimited"), Case(32, "polygons", 1000))


def relay() -> Iterator[Measurement]:
    """Measure the relay's processor time per frame in microseconds."""
    for case in CASES:
        plan = _plan(case)
        received = record_run(plan, [names.RELAY])[0][names.RELAY].received
        radio = [rights.read(*message) for message in received if names.parts(message.key)[0] == "radio"]
        frames = [frame.payload for message in radio for frame in message.frames]
        frames += [message.broadcast for message in radio if message.broadcast]
        relaying, decoding = [], []
        for _ in range(REPEATS):
            relaying.append(1000 * timed(partial(_relay, plan, received))[1] / len(frames))
            decoding.append(1000 * timed(partial(_decode, frames))[1] / len(frames))
        name = f"relay, {case.robots} robots, {case.map_encoding}, {case.bandwidth}: time per frame"
        yield compare(name, "us", relaying, "parsing its packets", decoding)


def _plan(case: Case) -> Plan:
    scenario = Scenario(
        robots=case.robots,
        steps=STEPS,
        map_encoding=case.map_encoding,
        strategy="meier",
        bandwidth=case.bandwidth,
        bus="memory",
    )
    return plans.make(scenario, generators.make("office", width_m=SIDE_M, height_m=SIDE_M))


def _relay(plan: Plan, received: list[Message]) -> None:
    node = RelayNode(RecordingBus(), Keys("memory"), plan.radio)
    for message in received:
        node.handle(message)


def _decode(frames: list[bytes]) -> None:
    for frame in frames:
        with contextlib.suppress(ProtocolError):
            packets.decode(frame)
