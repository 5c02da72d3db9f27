"""What one participant of a run hears, kept so that it can hear it again alone."""

from __future__ import annotations

from dataclasses import dataclass, field

from deploy.run import in_memory
from deploy.scenario.plan import Plan
from protocol.bus import Bus, Message


@dataclass
class RecordingBus:
    """An end of a bus that keeps what it hears, and counts what it says; without a bus nobody hears that."""

    inner: Bus | None = None
    heard: list[Message] = field(default_factory=list)
    said: int = 0

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


def recorded_for(plan: Plan, name: str) -> tuple[RecordingBus, int]:
    """Run a plan in memory; return what a participant heard, and how many steps it took."""
    ears: dict[str, RecordingBus] = {}

    def listen(who: str, bus: Bus) -> Bus:
        if who != name:
            return bus
        ears[who] = RecordingBus(bus)
        return ears[who]

    records = in_memory.run(plan, wrap=listen)
    return ears[name], records.step
