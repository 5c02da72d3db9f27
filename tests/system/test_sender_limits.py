"""A participant with a valid credential sends too much: the others continue, and the run has the same results."""

from __future__ import annotations

import socket
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from functools import partial
from pathlib import Path

import pytest

from deploy.dashboard.windows import free_port
from deploy.record.records import RecorderNode
from deploy.record.summary import digest
from deploy.run import launch
from deploy.run.in_memory import MemoryRun
from netshaper import access, certificates
from netshaper.admission import readers
from netshaper.hub import open_hub
from netshaper.settings import RadioSettings
from protocol import keys as names
from protocol import messages, packet_codec, packets, rights
from protocol.bus import Bus, Message
from protocol.errors import ProtocolError
from protocol.keys import Keys
from protocol.memory_bus import MemoryHub
from protocol.message_codec import pack, unpack
from protocol.messages import ErrorReport, Lost, MapChanges, RobotFrames, WorldReport
from protocol.packet_index import index_of
from protocol.zenoh_bus import Credential, join
from tests.system.team import small_plan

MB = 1 << 20
STEPS = 12
RADIO = RadioSettings(3, 0, 10.0, gossip=True)


class Heavy:
    """A connection to the bus that sends long messages to some receivers, once."""

    payload = b""

    def __init__(self, inner: Bus, sizes: dict[str, list[int]]) -> None:
        self._inner, self._sizes, self._received = inner, sizes, 0
        self.put, self.close = inner.put, inner.close

    def __getattr__(self, name: str) -> object:
        return getattr(self._inner, name)

    def receive(self, timeout_s: float | None = None) -> Message | None:
        message = self._inner.receive(timeout_s)
        self._received += message is not None
        if message is not None and self._received == 6:
            for key in rights.may_put(Keys(message.key.split("/")[1]), "r1"):
                plane, direction, first, _ = names.parts(key)
                for size in self._sizes.get(first if direction == "rx" else plane, []):
                    self._inner.put(key, bytes(size))
        return message


def heavy(sizes: dict[str, list[int]], name: str, bus: Bus) -> Bus:
    return Heavy(bus, sizes) if name == "r1" else bus


def play(tmp_path: Path, sizes: dict[str, list[int]], **settings: object) -> launch.Outcome:
    plan = small_plan(robots=3, steps=STEPS, **settings)
    outcome = launch.run(plan, tmp_path / "logs", wrap=partial(heavy, sizes))
    assert outcome.deaths.keys() <= {"r1"}
    assert outcome.records.end is not None
    assert outcome.records.end.step == STEPS
    return outcome


def test_long_messages_over_zenoh_are_faults_of_their_sender_and_change_nothing(tmp_path: Path) -> None:
    sizes = {names.WORLD: 8 * [4 * MB], names.RECORDER: [16 * MB], "radio": [16 * MB]}
    records = play(tmp_path, sizes).records
    assert records.lost == {}
    assert records.protocol_errors.counts.total() == 10
    assert all(error.startswith("r1: ") for error in records.protocol_errors.texts)
    assert digest(records) == digest(MemoryRun(small_plan(robots=3, steps=STEPS)).complete())


@pytest.mark.long
@pytest.mark.parametrize("receiver", [names.WORLD, names.RECORDER, "radio"])
@pytest.mark.parametrize("size", [64, 240])
def test_messages_beyond_the_hub_s_limit_lose_only_their_sender(
    tmp_path: Path, receiver: str, size: int
) -> None:
    records = play(tmp_path, {receiver: [size * MB]}, reply_timeout_s=5.0).records
    assert records.lost.keys() <= {1}
    assert records.own.keys() >= {0, 2}


def test_frames_of_one_robot_cannot_occupy_the_relay() -> None:
    class Flood(Heavy):
        def receive(self, timeout_s: float | None = None) -> Message | None:
            message = self._inner.receive(timeout_s)
            for _ in range(3 if message is not None else 0):
                key = Keys(message.key.split("/")[1]).radio_tx("r1") if message is not None else ""
                self._inner.put(key, self.payload)
            return message

    plan = small_plan(robots=3, steps=STEPS, bandwidth="unlimited")
    for frames in (15 * [bytes(16 * MB)], 4 * [bytes(5 * MB)]):
        outgoing = [messages.OutgoingFrame(0, frame) for frame in frames]
        Flood.payload = pack(RobotFrames(1, 0, "offers", frames=outgoing))
        began = time.monotonic()
        records = MemoryRun(plan, wrap=lambda name, bus: Flood(bus, {}) if name == "r1" else bus).complete()
        assert time.monotonic() - began < 15
        assert records.end is not None
        assert records.end.step == STEPS
        assert all(error.startswith("r1: ") for error in records.protocol_errors.texts)
        assert set(records.lost.values()) <= {rights.TOO_MANY_BYTES.format(rights.MAX_STEP_BYTES)}


@pytest.mark.parametrize("unit", [b"\x00", b"\xff", packet_codec.encode([packets.Offer(1, 0)])])
def test_frames_that_are_refused_cost_little_time(unit: bytes) -> None:
    frame = (MB // len(unit)) * unit
    for read in readers(RADIO).values():
        read(unit)
        began = time.monotonic()
        assert read(frame).problem
        assert time.monotonic() - began < 0.5


def test_an_error_deep_in_a_frame_names_its_position() -> None:
    frame = 1000 * packet_codec.encode([packets.Offer(1, 0)]) + b"\xff\xff"
    with pytest.raises(ProtocolError, match="at byte 2000: cut off after 2 of 6 bytes"):
        index_of(frame)


def test_caches_keep_no_long_frames() -> None:
    frame = bytes(100_000)
    held = sys.getrefcount(frame)
    for read in readers(RADIO).values():
        read(frame)
    assert sys.getrefcount(frame) == held


class Recording:
    """A recorder on the memory bus, and messages to it."""

    def __init__(self, robots: int = 3) -> None:
        self.hub = MemoryHub("memory", [names.RELAY, names.RECORDER])
        self.relay = self.hub.join(names.RELAY)
        self.recorder = RecorderNode(self.hub.join(names.RECORDER), self.hub.keys, robots, (10, 10))
        self.step = 0
        self.next_step()

    def next_step(self) -> None:
        self.step += 1
        self.send(names.WORLD, WorldReport(self.step, b"", [0, 0, 0], 1, 1))

    def send(self, sender: str, message: messages.Record) -> None:
        self.recorder.handle(Message(self.hub.keys.control(names.RECORDER, sender), pack(message)))

    def lost(self) -> list[Lost]:
        found = []
        while (message := self.relay.receive(0)) is not None:
            if names.parts(message.key)[0] == "presence":
                continue
            content = unpack(message.payload)
            found += [content] if isinstance(content, Lost) else []
        return found


def test_the_errors_of_one_robot_do_not_crowd_out_those_of_others() -> None:
    recording = Recording()
    for _ in range(3000):
        recording.send("r1", ErrorReport("r1", "noise"))
    recording.send("r2", ErrorReport("r2", "a real error"))
    records = recording.recorder.records
    assert records.protocol_errors.counts.total() == 3001
    assert "r2: a real error" in records.protocol_errors.texts
    assert len(records.protocol_errors.texts) <= 1001


def test_a_robot_that_reports_too_much_in_a_step_is_lost_and_ignored() -> None:
    recording = Recording()
    for step in range(2, 12):  # honest robots report less than the limit in each step
        for number in range(1000):
            recording.send("r0", ErrorReport("r0", f"{step} {number}" + 900 * "."))
        recording.next_step()
    assert recording.lost() == []
    for _ in range(20_000):
        recording.send("r1", ErrorReport("r1", 900 * "x"))
    (loss,) = recording.lost()
    assert loss.robot == 1
    assert "bytes in a step" in loss.cause
    count = recording.recorder.records.protocol_errors.counts.total()
    recording.send("r1", ErrorReport("r1", "again"))
    recording.send("r2", MapChanges(1, bytes(4), b"\x01"))
    assert recording.recorder.records.protocol_errors.counts.total() == count
    assert recording.recorder.records.maps.steps(2) == [1]


@contextmanager
def hub(protocol: str) -> Iterator[tuple[int, dict[str, Credential]]]:
    """A hub on the loopback interface: its port, and the credentials of its clients."""
    port = free_port()
    endpoint = f"{protocol}/127.0.0.1:{port}"
    if protocol == "tls":
        made = certificates.make(1, ["127.0.0.1"])
        credentials, certificate = certificates.credentials("run", endpoint, made), made[names.RELAY]
    else:
        credentials, certificate = access.issue("run", endpoint, 1), None
    with closing(open_hub("run", endpoint, credentials, certificate)):
        yield port, credentials


@pytest.mark.parametrize(
    ("protocol", "connections"),
    [
        ("tcp", 300),
        pytest.param("tcp", 1300, marks=pytest.mark.long),
        pytest.param("tls", 1300, marks=pytest.mark.long),
    ],
)
def test_half_open_connections_keep_no_robot_out(protocol: str, connections: int) -> None:
    with hub(protocol) as (port, credentials), ExitStack() as stack:
        for _ in range(connections):
            stack.enter_context(socket.create_connection(("127.0.0.1", port)))
        began = time.monotonic()
        join(credentials[names.WORLD]).close()
        assert time.monotonic() - began < 5
