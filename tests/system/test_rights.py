"""A participant with a valid credential sends every message that it may not send, in every phase."""

from __future__ import annotations

import zlib
from collections import Counter
from functools import cache, partial
from pathlib import Path
from typing import Any

import pytest

from deploy.record.records import Records
from deploy.record.summary import digest
from deploy.run import launch
from deploy.run.in_memory import MemoryRun
from deploy.scenario.plan import Plan
from protocol import keys as names
from protocol import message_codec, messages, packet_codec, packets, rights
from protocol.budget import Budget
from protocol.bus import Bus, Message
from protocol.grid import FREE, UNKNOWN
from protocol.keys import Keys
from protocol.message_codec import pack
from tests.system.team import small_plan

EXAMPLES: tuple[messages.Record, ...] = (
    messages.Begin(),
    messages.Configure(0, b"settings"),
    messages.Sense(3, 4, 4, 0, b"", bytes(720), ""),
    messages.Move(3, b"", 0, explored=True),
    messages.Positions(3, [0, 1, 2], [4, 4, 4], [4, 4, 4]),
    messages.Open(3, 0, [0, 2], Budget(1000)),
    messages.Broadcasts(3, [messages.Delivery(0, b"pose")]),
    messages.PhaseDelivery(3, 0, "offers", [messages.Delivery(0, b"offer", 0, 0)]),
    messages.RobotFrames(3, 0, "offers"),
    messages.RoundReport(3, 0, [messages.ConnectionReport(0, 2, 2, 2)], [], [], broadcast_sent=True),
    messages.Close(3),
    messages.RelayUpdate([messages.Close(3)]),
    messages.Lost(0, "I saw it die"),
    messages.End(3, "explored", 1),
    messages.Stop("enough"),
    messages.Shutdown(),
    messages.WorldReport(3, bytes(48), [1, 2, 3], 90, 90),
    messages.RobotStatus(3, 4, 4, 9, 0, -1, 0, "idle", 1),
    messages.RadioReport(3, bytes(7), 0, b"frames"),
    messages.MapPart(0, b"\x01"),
    messages.RequestMaps(0, 3, 0),
    messages.ErrorReport("r0", "I say so"),
    messages.Missed(3, "offers", 0, [0]),
    messages.Watched(here=True),
    messages.Back(0),
    messages.Reconnected(0),
    messages.FaultEvent(3, 0, "kill"),
    messages.Change(3, Budget(100), 5000),
    messages.Snapshot(3, 1, 1, b"\x00"),
    messages.MapChanges(3, b"\x01\x00\x00\x00", b"\x0a"),
    messages.Outlines(3, 0, bytes(16)),
)
JUNK = (
    b"",
    b"\xc1",
    1000 * b"\x91",
    bytes(9_000_000),
    pack(messages.MapPart(0, zlib.compress(bytes(81)))),
    pack(messages.RobotFrames(1, 0, "offers", frames=10**6 * [messages.OutgoingFrame(0, b"")])),
    pack(messages.Move(1, bytes(8 << 20), 0, explored=True)),
)
STEPS, OFTEN = 12, 8


def all_keys(keys: Keys, name: str) -> list[str]:
    """Keys for a participant without any rights: the memory bus lets it put, a hub would not."""
    return [keys.control_tx(name), keys.body("*", name)] + [
        keys.control(receiver, name) for receiver in (names.WORLD, names.RECORDER, "*")
    ]


def forbidden(keys: Keys, name: str) -> list[Message]:
    """All messages that a participant can put but may not send: every kind to every receiver, and malformed bytes."""
    found = []
    for key in rights.may_put(keys, name) or all_keys(keys, name):
        for receiver in ("r0", "r2") if "*" in key else ("",):
            place = key.replace("*", receiver)
            plane, direction, first, second = names.parts(place)
            ends = (first, names.RELAY) if direction == "tx" else (second, first)
            roles = tuple(rights.ROBOT if end[1:].isdigit() else end for end in ends)
            pair = roles[0], roles[1]
            may = [kind for kind in rights.RIGHTS.get(pair, ()) if rights.plane_of(kind, pair) == plane]
            found += [Message(place, pack(each)) for each in EXAMPLES if type(each) not in may]
            found += [Message(place, junk) for junk in JUNK]
    return found


class Rogue:
    """A bus connection that sends all forbidden messages after each received message, and so in every phase."""

    def __init__(self, inner: Bus, name: str, most_bytes: int = 1 << 30) -> None:
        self._inner, self._name, self._most_bytes = inner, name, most_bytes
        self._messages: list[Message] = []
        self._received = Counter[str]()
        self.put, self.close = inner.put, inner.close

    def receive(self, timeout_s: float | None = None) -> Message | None:
        message = self._inner.receive(timeout_s)
        if message is None:
            return None
        if not self._messages:
            found = self._forbidden(Keys(message.key.split("/")[1]))
            self._messages = [each for each in found if len(each.payload) <= self._most_bytes]
        is_message = names.parts(message.key)[0] != "presence"
        kind = type(message_codec.unpack(message.payload)).__name__ if is_message else "presence"
        self._received[kind] += 1
        for each in self._messages if self._received[kind] <= OFTEN else ():
            self._inner.put(*each)
        return message

    def _forbidden(self, keys: Keys) -> list[Message]:
        return forbidden(keys, self._name)


@cache
def plan() -> Plan:
    return small_plan(robots=3, steps=STEPS)


class Listener:
    """A viewer that ignores all messages until the run is over."""

    done = False

    def handle(self, message: Message) -> None:
        self.done = isinstance(message_codec.unpack(message.payload), messages.Shutdown)


def play(rogue: str = "") -> Records:
    def wrap(name: str, bus: Bus) -> Bus:
        return Rogue(bus, name) if name == rogue else bus

    return MemoryRun(plan(), wrap=wrap, view=Listener() if rogue == names.VIEW else None).complete()


@cache
def honest_digest() -> str:
    return digest(play())


def test_there_is_an_example_of_every_kind() -> None:
    kinds: Any = messages.Record.__subclasses__()
    assert {type(each) for each in EXAMPLES} == set(kinds)


@pytest.mark.parametrize("rogue", ["r1", names.WORLD, names.RECORDER, names.RELAY, names.VIEW])
def test_a_forbidden_message_is_a_fault_with_its_sender_s_name_and_changes_nothing(rogue: str) -> None:
    records = play(rogue)
    assert digest(records) == honest_digest()
    assert records.end is not None
    assert records.end.step == STEPS
    assert records.lost == {}
    assert records.protocol_errors.counts.total() > 100
    assert {fault.split(":")[0] for fault in records.protocol_errors.texts} <= {rogue, "r0", "r2"}
    reason = f"{rogue} may {'send no message' if rogue == names.VIEW else 'not send it'} here"
    assert any(fault.startswith(f"{rogue}: ") and reason in fault for fault in records.protocol_errors.texts)


def rogue_over_zenoh(rogue: str, name: str, bus: Bus) -> Bus:
    return Rogue(bus, name, 1 << 20) if name == rogue else bus


@pytest.mark.parametrize("rogue", ["r1", names.WORLD, names.RECORDER])
def test_over_zenoh_a_forbidden_message_changes_nothing(tmp_path: Path, rogue: str) -> None:
    outcome = launch.run(plan(), tmp_path / "logs", wrap=partial(rogue_over_zenoh, rogue))
    assert outcome.deaths == {}
    records = outcome.records
    assert digest(records) == honest_digest()
    assert records.lost == {}
    assert records.protocol_errors.counts.total() > 100
    assert {fault.split(":")[0] for fault in records.protocol_errors.texts} <= {rogue, "r0", "r2"}
    assert any(f"{rogue} may not send it here" in fault for fault in records.protocol_errors.texts)


NOISE = (
    b"",
    b"\xff\x00",
    bytes(range(256)),
    bytes(100_000),
    1000 * packet_codec.encode([packets.Save()]),
    *(
        packet_codec.encode([each])
        for each in (
            packets.Offer(1, 0),
            packets.Answer(4095),
            packets.Block(63),
            packets.Block(packets.DECLINED),
            packets.Emerge(4000, 5, 1),
            packets.Insert(9, 4000, 4000, 0, 1),
            packets.Fragment(b"noise"),
            packets.From(63, 4095),
            packets.Held(63, 4095),
            packets.Gone(0),
            packets.Update(1, b"noise"),
        )
    ),
)


class NoiseSender(Rogue):
    """A bus connection that sends noise on its robot's radio keys after each received message."""

    def _forbidden(self, keys: Keys) -> list[Message]:
        in_messages = [
            pack(
                messages.RobotFrames(
                    1, 0, phase, noise, [messages.OutgoingFrame(n, noise, n) for n in (-1, 0, 1, 2, 9)]
                )
            )
            for phase in ("offers", "answers", "data")
            for noise in NOISE
        ]
        return [Message(keys.radio_tx(self._name), noise) for noise in (*NOISE, *in_messages)]


@pytest.mark.parametrize("map_encoding", ["polygons", "scans", "predictive"])
@pytest.mark.parametrize("dissemination", ["backoff", "gossip"])
def test_noise_on_the_radio_in_every_phase_stops_no_robot(map_encoding: str, dissemination: str) -> None:
    noisy = small_plan(robots=3, steps=STEPS, map_encoding=map_encoding, dissemination=dissemination)
    truth = noisy.map.cells
    records = MemoryRun(
        noisy, wrap=lambda name, bus: NoiseSender(bus, name) if name == "r1" else bus
    ).complete()
    assert records.end is not None
    assert records.end.step == STEPS
    assert records.lost.keys() <= {1}
    assert records.protocol_errors.counts.total() > 100
    for robot in (0, 2):
        known = records.own[robot] != UNKNOWN
        assert known.sum() > 100
        assert ((records.own[robot] == FREE) == (truth == FREE))[known].all()


class Silent:
    """A bus connection that drops its robot's messages of one kind from the `after`-th on."""

    def __init__(self, inner: Bus, kind: type[messages.Record], after: int) -> None:
        self._inner, self._kind, self._left = inner, kind, after
        self.receive, self.close = inner.receive, inner.close

    def put(self, key: str, payload: bytes) -> None:
        if isinstance(message_codec.unpack(payload), self._kind):
            self._left -= 1
            if self._left < 0:
                return
        self._inner.put(key, payload)


@pytest.mark.parametrize("kind", [messages.Move, messages.RobotFrames, messages.MapPart])
@pytest.mark.parametrize("after", [0, 7])
def test_a_robot_that_omits_an_expected_message_is_given_up_and_the_others_continue(
    kind: type[messages.Record], after: int
) -> None:
    def wrap(name: str, bus: Bus) -> Bus:
        return Silent(bus, kind, after) if name == "r1" else bus

    records = MemoryRun(plan(), wrap=wrap).complete()
    assert records.end is not None
    assert records.end.step == STEPS
    lost = "it did not send its maps" if kind is messages.MapPart else "timed out"
    if kind is not messages.MapPart or not after:
        assert list(records.lost) == [1]
        assert lost in records.lost[1]
    assert sorted({0, 1, 2} - records.own.keys()) == sorted(records.lost)
