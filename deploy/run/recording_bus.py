"""Record the messages that participants of a run receive."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field

from deploy.run.in_memory import MemoryRun
from deploy.scenario.plan import Plan
from protocol import keys as names
from protocol.bus import Bus, Message
from protocol.message_codec import unpack
from protocol.messages import Sense


@dataclass
class RecordingBus:
    """One end of a bus that records the received messages."""

    inner: Bus | None = None
    """The bus; without one, sent messages are discarded."""
    received: list[Message] = field(default_factory=list)
    """Received messages in their order."""

    def put(self, key: str, payload: bytes) -> None:
        """Send a message."""
        if self.inner is not None:
            self.inner.put(key, payload)

    def receive(self, timeout_s: float | None = None) -> Message | None:
        """Receive a message and record it."""
        message = self.inner.receive(timeout_s) if self.inner is not None else None
        if message is not None:
            self.received.append(message)
        return message

    def close(self) -> None:
        """Leave the bus."""
        if self.inner is not None:
            self.inner.close()


def record_run(plan: Plan, participants: Collection[str]) -> dict[str, list[Message]]:
    """Run a plan in memory; return the messages that each of the participants received."""
    buses: dict[str, RecordingBus] = {}

    def wrap(name: str, bus: Bus) -> Bus:
        if name not in participants:
            return bus
        buses[name] = RecordingBus(bus)
        return buses[name]

    MemoryRun(plan, wrap=wrap).complete()
    return {name: bus.received for name, bus in buses.items()}


def record_senses(plan: Plan) -> list[list[Sense]]:
    """Run a plan in memory; return the sensor messages of each robot."""
    robots = list(map(names.robot, range(plan.scenario.robots)))
    received = record_run(plan, robots)
    bodies = (
        [unpack(m.payload) for m in received[name] if names.parts(m.key)[0] == "body"] for name in robots
    )
    return [[message for message in messages if isinstance(message, Sense)] for messages in bodies]
