"""Upper bound of a swarm's speed: its own messages without any computation.

A run on the memory bus is recorded as one script per participant. On Zenoh the same processes then replay the scripts
with payloads of equal size.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from deploy.record.records import Records
from deploy.run.process_table import ProcessTable
from deploy.run.processes import FAREWELL_S, schedule_as_batch
from deploy.run.recording_bus import RecordingBus, record_run
from deploy.run.rendezvous import on_loopback
from deploy.scenario.plan import Plan
from netshaper.hub import open_hub
from protocol import keys as names
from protocol.bus import Bus, Message
from protocol.keys import Keys
from protocol.zenoh_bus import Credential, join, send_along


@dataclass(frozen=True)
class Script:
    """The messages of one participant.

    Attributes
    ----------
    sends : list of (int, str, int)
        Number of received messages before the send, key, payload size in bytes.
    total : int
        Number of messages that it receives.
    """

    sends: list[tuple[int, str, int]]
    total: int


def record(plan: Plan) -> tuple[dict[str, Script], Records]:
    """Run a plan in memory; return each participant's script, and the run's records."""
    buses, records = record_run(plan)
    return {name: _script(bus) for name, bus in buses.items()}, records


def replay(plan: Plan, scripts: dict[str, Script]) -> float:
    """Replay the scripts by processes on Zenoh; return the seconds from the first to the last message."""
    with tempfile.TemporaryDirectory() as folder, ProcessTable(Path(folder)) as processes:
        rendezvous = on_loopback(plan.scenario.robots)
        hub = rendezvous.run, rendezvous.endpoint, rendezvous.credentials
        processes.start(names.RELAY, _replay_hub, *hub, len(scripts) - 1, scripts[names.RELAY])
        for name, script in scripts.items():
            if name not in (names.RELAY, names.RECORDER):
                processes.start(name, _replay_client, rendezvous.credentials[name], script)

        def check() -> None:
            if processes.look():
                raise ConnectionError(f"the benchmark's replay failed: {processes.deaths}")

        with closing(join(rendezvous.credentials[names.RECORDER])) as bus:
            return _replay(bus, Keys(rendezvous.run), scripts[names.RECORDER], check)


def _script(bus: RecordingBus) -> Script:
    """The script of a recorded participant, without presence messages."""
    counts = [0]
    for message in bus.received:
        counts.append(counts[-1] + _counts(message))
    sends = [(counts[after], message.key, len(message.payload)) for after, message in bus.sent]
    return Script(sends, counts[-1])


def _counts(message: Message) -> bool:
    return names.parts(message.key)[0] != "presence"


def _replay_hub(
    run: str, endpoint: str, credentials: dict[str, Credential], clients: int, script: Script
) -> None:
    """Replay the relay's script once the given number of clients has joined."""
    with closing(open_hub(run, endpoint, credentials)) as bus:
        present: set[str] = set()
        received = 0
        while len(present) < clients:
            message = bus.receive()
            if message is not None and _counts(message):
                received += 1
            elif message is not None:
                present.add(message.key)
        _replay(bus, Keys(run), script, received=received)
        deadline = time.monotonic() + FAREWELL_S
        while time.monotonic() < deadline and present:
            message = bus.receive(0.5)
            if message is not None and message.payload == b"0":
                present.discard(message.key)


def _replay_client(credential: Credential, script: Script) -> None:
    """Replay the script of a robot or the world."""
    if names.is_robot(credential.name):
        schedule_as_batch()
    send_along()
    with closing(join(credential)) as bus:
        _replay(bus, Keys(credential.run), script)


def _replay(
    bus: Bus, keys: Keys, script: Script, check: Callable[[], object] = lambda: None, *, received: int = 0
) -> float:
    """Replay a script of which `received` messages have arrived; return the seconds from the next one on."""
    began = 0.0
    sends = [(after, _with_run(key, keys), bytes(size)) for after, key, size in script.sends]
    for after, key, payload in [*sends, (script.total, "", b"")]:
        while received < after:
            message = bus.receive(1.0)
            if message is None:
                check()
            elif _counts(message):
                began = began or time.perf_counter()
                received += 1
        if key:
            bus.put(key, payload)
    return time.perf_counter() - began


def _with_run(key: str, keys: Keys) -> str:
    """The same key in another run."""
    root, _, *rest = key.split("/")
    return "/".join([root, keys.run, *rest])
