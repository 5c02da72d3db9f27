"""Bench of the relay: what a frame costs from the word that says it to ledger and capture, without any bus.

All that the relay hears in a run in memory is written down, and told again to a relay whose words go nowhere. The
yardstick is to read the packets of the same frames one by one (`protocol.packets.decode`), and nothing else.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from deploy.bench.ratios import Figure, compare
from deploy.bench.recording_bus import RecordingBus, recorded_for
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
    """A team whose relay is measured."""

    robots: int
    map_encoding: str
    bandwidth: int | Literal["unlimited"]


CASES = (Case(8, "polygons", 1000), Case(8, "scans", "unlimited"), Case(32, "polygons", 1000))


def relay() -> Iterator[Figure]:
    """The relay's work a frame, in microseconds."""
    for case in CASES:
        plan = _plan(case)
        recording_bus, _ = recorded_for(plan, names.RELAY)
        heard = recording_bus.heard
        sent = [rights.read(*message) for message in heard if names.parts(message.key)[0] == "radio"]
        frames = [frame.payload for message in sent for frame in message.frames]
        frames += [message.broadcast for message in sent if message.broadcast]
        ours, theirs = [], []
        for _ in range(REPEATS):
            ours.append(_relaying(plan, heard) / len(frames))
            theirs.append(_decoding(frames) / len(frames))
        what = f"relay, {case.robots} robots, {case.map_encoding}, {case.bandwidth}: work a frame"
        yield compare(what, "us", ours, "reading its packets", theirs)


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


def _relaying(plan: Plan, heard: list[Message]) -> float:
    """Tell a new relay all of it; return the microseconds of processor time that it takes."""
    node = RelayNode(RecordingBus(), Keys("memory"), plan.radio)
    began = time.thread_time_ns()
    for message in heard:
        node.handle(message)
    return (time.thread_time_ns() - began) / 1000


def _decoding(frames: list[bytes]) -> float:
    began = time.thread_time_ns()
    for frame in frames:
        try:
            packets.decode(frame)
        except ProtocolError:
            continue
    return (time.thread_time_ns() - began) / 1000
