"""Record the messages that participants of a run receive."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field

from deploy.record.records import Records
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

    @property
    def senses(self) -> list[Sense]:
        """The received sensor messages."""
        bodies = (unpack(m.payload) for m in self.received if names.parts(m.key)[0] == "body")
        return [message for message in bodies if isinstance(message, Sense)]


def record_run(
    plan: Plan, participants: Collection[str] | None = None
) -> tuple[dict[str, RecordingBus], Records]:
    """Run a plan in memory; return the recorded bus of each participant (default: all), and the run's records."""
    buses: dict[str, RecordingBus] = {}

    def wrap(name: str, bus: Bus) -> Bus:
        if participants is not None and name not in participants:
            return bus
        buses[name] = RecordingBus(bus)
        return buses[name]

    records = MemoryRun(plan, wrap=wrap).complete()
    return buses, records
