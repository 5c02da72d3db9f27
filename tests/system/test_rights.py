"""A participant with a valid credential says everything that it may not, whenever it says anything at all."""

from __future__ import annotations

from collections import Counter
from functools import cache, partial
from pathlib import Path
from typing import Any

import pytest

from deploy.record.records import Records
from deploy.record.summary import digest
from deploy.run import in_memory, launch
from deploy.scenario.plan import Plan
from protocol import keys as names
from protocol import messages, packets, rights
from protocol.budget import Budget
from protocol.bus import Bus, Message
from protocol.grid import FREE, UNKNOWN
from protocol.keys import Keys
from protocol.messages import pack
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
    messages.Maps(0, 1, 1, b"\x01", b"\x01"),
    messages.Fault("r0", "I say so"),
    messages.Watched(here=True),
    messages.Back(0),
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
    pack(messages.Maps(0, 9, 9, bytes(81), bytes(81))),
    pack(messages.RobotFrames(1, 0, "offers", frames=10**6 * [messages.OutgoingFrame(0, b"")])),
    pack(messages.Move(1, bytes(8 << 20), 0, explored=True)),
)
STEPS, OFTEN = 12, 8


def everywhere(keys: Keys, name: str) -> list[str]:
    """Where somebody speaks who may say nothing: a hub would not let it, memory does."""
    return [keys.control_tx(name), keys.body("*", name)] + [
        keys.control(receiver, name) for receiver in (names.WORLD, names.RECORDER, "*")
    ]


def forbidden(keys: Keys, name: str) -> list[Message]:
    """All that a participant can put but may not say: every kind to everyone, and what is no message."""
    found = []
    for key in rights.may_put(keys, name) or everywhere(keys, name):
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
    """The end of the bus of who says all that it may not, whenever it has heard something: in every phase."""

    def __init__(self, inner: Bus, name: str, most_bytes: int = 1 << 30) -> None:
        self._inner, self._name, self._most_bytes = inner, name, most_bytes
        self._lies: list[Message] = []
        self._heard = Counter[str]()
        self.put, self.close = inner.put, inner.close

    def receive(self, timeout_s: float | None = None) -> Message | None:
        message = self._inner.receive(timeout_s)
        if message is None:
            return None
        if not self._lies:
            lies = self._words(Keys(message.key.split("/")[1]))
            self._lies = [lie for lie in lies if len(lie.payload) <= self._most_bytes]
        told = names.parts(message.key)[0] != "presence"
        kind = type(messages.unpack(message.payload)).__name__ if told else "presence"
        self._heard[kind] += 1
        for lie in self._lies if self._heard[kind] <= OFTEN else ():
            self._inner.put(*lie)
        return message

    def _words(self, keys: Keys) -> list[Message]:
        return forbidden(keys, self._name)


@cache
def plan() -> Plan:
    return small_plan(robots=3, steps=STEPS)


class Listener:
    """A viewer that looks at nothing, until the run is over."""

    done = False

    def handle(self, message: Message) -> None:
        self.done = isinstance(messages.unpack(message.payload), messages.Shutdown)


def play(rogue: str = "") -> Records:
    def wrap(name: str, bus: Bus) -> Bus:
        return Rogue(bus, name) if name == rogue else bus

    return in_memory.run(plan(), wrap=wrap, view=Listener() if rogue == names.VIEW else None)


@cache
def honest_digest() -> str:
    return digest(play())


def test_there_is_an_example_of_every_kind() -> None:
    kinds: Any = messages.Record.__subclasses__()
    assert {type(each) for each in EXAMPLES} == set(kinds)


@pytest.mark.parametrize("rogue", ["r1", names.WORLD, names.RECORDER, names.RELAY, names.VIEW])
def test_what_is_not_ones_to_say_is_a_fault_with_ones_name_and_changes_nothing(rogue: str) -> None:
    records = play(rogue)
    assert digest(records) == honest_digest()
    assert records.end is not None
    assert records.end.step == STEPS
    assert records.lost == {}
    assert records.protocol_error_count > 100
    assert {fault.split(":")[0] for fault in records.protocol_errors} <= {rogue, "r0", "r2"}
    reason = f"{'nothing is' if rogue == names.VIEW else 'not'} for {rogue} to say"
    assert any(fault.startswith(f"{rogue}: ") and reason in fault for fault in records.protocol_errors)


def rogue_over_zenoh(rogue: str, name: str, bus: Bus) -> Bus:
    return Rogue(bus, name, 1 << 20) if name == rogue else bus


@pytest.mark.parametrize("rogue", ["r1", names.WORLD, names.RECORDER])
def test_over_zenoh_what_is_not_ones_to_say_changes_nothing_either(tmp_path: Path, rogue: str) -> None:
    outcome = launch.run(plan(), tmp_path / "logs", wrap=partial(rogue_over_zenoh, rogue))
    assert outcome.deaths == {}
    records = outcome.records
    assert digest(records) == honest_digest()
    assert records.lost == {}
    assert records.protocol_error_count > 100
    assert {fault.split(":")[0] for fault in records.protocol_errors} <= {rogue, "r0", "r2"}
    assert any(f"not for {rogue} to say" in fault for fault in records.protocol_errors)


NOISE = (
    b"",
    b"\xff\x00",
    bytes(range(256)),
    bytes(100_000),
    1000 * packets.encode([packets.Save()]),
    *(
        packets.encode([each])
        for each in (
            packets.Offer(1, 0),
            packets.Answer(4095),
            packets.Block(63),
            packets.Decline(),
            packets.Emerge(4000, 5, 1),
            packets.Insert(9, 4000, 4000, 0, 1),
            packets.Fragment(b"noise"),
            packets.From(63, 4095),
            packets.Held(63, 4095),
            packets.Gone(0),
            packets.Update(3, b"noise"),
        )
    ),
)


class Babbler(Rogue):
    """The end of the bus of a robot whose radio says noise, whenever it has heard something: in every phase."""

    def _words(self, keys: Keys) -> list[Message]:
        spoken = [
            pack(
                messages.RobotFrames(
                    1, 0, phase, noise, [messages.OutgoingFrame(n, noise, n) for n in (-1, 0, 1, 2, 9)]
                )
            )
            for phase in ("offers", "answers", "data")
            for noise in NOISE
        ]
        return [Message(keys.radio_tx(self._name), noise) for noise in (*NOISE, *spoken)]


@pytest.mark.parametrize("map_encoding", ["polygons", "scans", "predictive"])
@pytest.mark.parametrize("dissemination", ["backoff", "gossip"])
def test_noise_on_the_radio_in_every_phase_stops_nobody(map_encoding: str, dissemination: str) -> None:
    noisy = small_plan(robots=3, steps=STEPS, map_encoding=map_encoding, dissemination=dissemination)
    truth = noisy.map.cells
    records = in_memory.run(noisy, wrap=lambda name, bus: Babbler(bus, name) if name == "r1" else bus)
    assert records.end is not None
    assert records.end.step == STEPS
    assert records.lost.keys() <= {1}
    assert records.protocol_error_count > 100
    for robot in (0, 2):
        known = records.own[robot] != UNKNOWN
        assert known.sum() > 100
        assert ((records.own[robot] == FREE) == (truth == FREE))[known].all()


class Silent:
    """The end of the bus of a robot that never says messages of one kind, from the `after`-th on."""

    def __init__(self, inner: Bus, kind: type[messages.Record], after: int) -> None:
        self._inner, self._kind, self._left = inner, kind, after
        self.receive, self.close = inner.receive, inner.close

    def put(self, key: str, payload: bytes) -> None:
        if isinstance(messages.unpack(payload), self._kind):
            self._left -= 1
            if self._left < 0:
                return
        self._inner.put(key, payload)


@pytest.mark.parametrize("kind", [messages.Move, messages.RobotFrames, messages.Maps])
@pytest.mark.parametrize("after", [0, 7])
def test_who_does_not_say_what_is_waited_for_is_given_up_and_the_others_go_on(
    kind: type[messages.Record], after: int
) -> None:
    def wrap(name: str, bus: Bus) -> Bus:
        return Silent(bus, kind, after) if name == "r1" else bus

    records = in_memory.run(plan(), wrap=wrap)
    assert records.end is not None
    assert records.end.step == STEPS
    lost = "did not hand in its maps" if kind is messages.Maps else "timed out"
    if kind is not messages.Maps or not after:
        assert list(records.lost) == [1]
        assert lost in records.lost[1]
    assert sorted({0, 1, 2} - records.own.keys()) == sorted(records.lost)
