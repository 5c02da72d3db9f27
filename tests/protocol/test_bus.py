"""The contract of the bus interface, for the memory bus and the Zenoh bus."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass

import pytest

from deploy.dashboard.windows import free_port
from netshaper import access
from netshaper.hub import open_hub
from protocol import keys as names
from protocol.bus import Bus, BusClosed, Message
from protocol.keys import Keys
from protocol.memory_bus import MemoryHub
from protocol.zenoh_bus import join

KEYS = Keys("contract")
RELAY, WORLD, RECORDER, R0, R1 = names.RELAY, names.WORLD, names.RECORDER, "r0", "r1"
SOON_S = 30.0
"""Longest wait for a message that must arrive. On a busy machine, a connection takes seconds."""
LOSS_S = 60.0
"""Maximum time until a robot detects that the hub is gone; usually 4.25 s, as it may only have lost its connection."""


@dataclass
class Rendezvous:
    """All ends of one run, and how to open another."""

    open: Callable[[str], Bus]
    ends: dict[str, Bus]

    def __getitem__(self, name: str) -> Bus:
        return self.ends[name]

    def receive(self, name: str) -> Message:
        """Wait for the next message of `name`."""
        message = self.ends[name].receive(SOON_S)
        assert message is not None, f"{name} received nothing"
        return message

    def everything_before_a_fence(self) -> dict[str, list[Message]]:
        """Return the messages that each end has received, once all earlier messages must have arrived.

        Each participant in turn puts a marker for the relay, which then puts one for each participant.
        """
        received: dict[str, list[Message]] = {name: [] for name in self.ends}
        for name in self.ends:
            if name != RELAY:
                self.ends[name].put(KEYS.control_tx(name), b"fence")
                while (message := self.receive(RELAY)).payload != b"fence":
                    received[RELAY].append(message)
        for name in self.ends:
            if name != RELAY:
                self.ends[RELAY].put(KEYS.control(name, RELAY), b"fence")
                while (message := self.receive(name)).payload != b"fence":
                    received[name].append(message)
        return received


@pytest.fixture(params=["memory", "zenoh"])
def rendezvous(request: pytest.FixtureRequest) -> Iterator[Rendezvous]:
    """Relay, world, recorder and two robots; the relay has read their presence messages."""
    with ExitStack() as stack:
        if request.param == "memory":
            hub = MemoryHub(KEYS.run)
            opener: Callable[[str], Bus] = hub.join
            relay: Bus = hub.join(RELAY)
        else:
            endpoint = f"tcp/127.0.0.1:{free_port()}"
            credentials = access.issue(KEYS.run, endpoint, 2)
            relay = open_hub(KEYS.run, endpoint, credentials)

            def opener(name: str) -> Bus:
                return join(credentials[name])

        ends = {RELAY: relay}
        stack.callback(close_all, ends)
        for name in (WORLD, RECORDER, R0, R1):
            ends[name] = opener(name)
        rendezvous = Rendezvous(opener, ends)
        came = {rendezvous.receive(RELAY).key for _ in range(4)}
        assert came == {KEYS.presence(name) for name in (WORLD, RECORDER, R0, R1)}
        yield rendezvous


def close_all(ends: dict[str, Bus]) -> None:
    for end in reversed(ends.values()):
        end.close()


ROUTES = [
    (R0, KEYS.radio_tx(R0), RELAY),
    (R0, KEYS.control_tx(R0), RELAY),
    (R0, KEYS.body(WORLD, R0), WORLD),
    (R0, KEYS.control(RECORDER, R0), RECORDER),
    (RELAY, KEYS.radio_rx(R0, R1), R0),
    (RELAY, KEYS.control(R0, RELAY), R0),
    (RELAY, KEYS.control(WORLD, RELAY), WORLD),
    (RELAY, KEYS.control(RECORDER, RELAY), RECORDER),
    (WORLD, KEYS.body(R0, WORLD), R0),
    (WORLD, KEYS.control_tx(WORLD), RELAY),
    (WORLD, KEYS.control(RECORDER, WORLD), RECORDER),
    (RECORDER, KEYS.control_tx(RECORDER), RELAY),
]


@pytest.mark.parametrize(
    ("sender", "key", "receiver"), ROUTES, ids=lambda value: value.replace("murmur/", "")
)
def test_a_message_reaches_the_addressed_inbox_and_no_other(
    rendezvous: Rendezvous, sender: str, key: str, receiver: str
) -> None:
    rendezvous[sender].put(key, b"hello")
    received = rendezvous.everything_before_a_fence()
    assert received.pop(receiver) == [Message(key, b"hello")]
    assert not any(received.values())


@pytest.mark.parametrize("size", [0, 1, 724, 1 << 20])
def test_a_payload_arrives_whole_whatever_its_size(rendezvous: Rendezvous, size: int) -> None:
    payload = (b"murmur" * (size // 6 + 1))[:size]
    rendezvous[R0].put(KEYS.radio_tx(R0), payload)
    rendezvous[RELAY].put(KEYS.radio_rx(R1, R0), payload)
    assert rendezvous.receive(RELAY).payload == payload
    assert rendezvous.receive(R1).payload == payload


@pytest.mark.parametrize(
    ("sender", "receiver", "routes"),
    [
        (RELAY, R0, [KEYS.radio_rx(R0, R1), KEYS.control(R0, RELAY)]),
        (R0, RELAY, [KEYS.radio_tx(R0), KEYS.control_tx(R0)]),
        (R0, WORLD, [KEYS.body(WORLD, R0)]),
        (WORLD, R0, [KEYS.body(R0, WORLD)]),
        (R0, RECORDER, [KEYS.control(RECORDER, R0)]),
    ],
)
def test_thousands_of_messages_arrive_once_and_in_order_over_all_planes(
    rendezvous: Rendezvous, sender: str, receiver: str, routes: list[str]
) -> None:
    sent = [Message(routes[n % len(routes)], b"%d" % n) for n in range(5000)]
    for message in sent:
        rendezvous[sender].put(message.key, message.payload)
    assert [rendezvous.receive(receiver) for _ in sent] == sent
    assert not any(rendezvous.everything_before_a_fence().values())


def test_messages_of_several_senders_arrive_in_the_order_of_each(rendezvous: Rendezvous) -> None:
    senders = {
        R0: KEYS.control(RECORDER, R0),
        R1: KEYS.control(RECORDER, R1),
        WORLD: KEYS.control(RECORDER, WORLD),
    }
    for n in range(1000):
        for name, key in senders.items():
            rendezvous[name].put(key, b"%d" % n)
    received = [rendezvous.receive(RECORDER) for _ in range(3000)]
    for key in senders.values():
        assert [message.payload for message in received if message.key == key] == [
            b"%d" % n for n in range(1000)
        ]


def test_large_and_small_messages_do_not_overtake_each_other(rendezvous: Rendezvous) -> None:
    sizes = [1 << 20, 0, 1, 300_000, 2, 1 << 20, 3]
    for size in sizes:
        rendezvous[RELAY].put(KEYS.control(R0, RELAY), bytes(size))
    assert [len(rendezvous.receive(R0).payload) for _ in sizes] == sizes


def test_the_first_messages_of_a_new_participant_arrive(rendezvous: Rendezvous) -> None:
    for _ in range(20):
        rendezvous[R1].close()
        assert rendezvous.receive(RELAY) == Message(KEYS.presence(R1), b"0")
        rendezvous.ends[R1] = rendezvous.open(R1)
        rendezvous[R1].put(KEYS.radio_tx(R1), b"I am here")
        received = {rendezvous.receive(RELAY), rendezvous.receive(RELAY)}
        assert received == {Message(KEYS.presence(R1), b"1"), Message(KEYS.radio_tx(R1), b"I am here")}
        rendezvous[RELAY].put(KEYS.control(R1, RELAY), b"welcome")
        assert rendezvous.receive(R1).payload == b"welcome"


def test_the_notice_that_a_participant_left_follows_its_last_message(rendezvous: Rendezvous) -> None:
    for n in range(2000):
        rendezvous[R0].put(KEYS.radio_tx(R0), b"%d" % n)
    rendezvous[R0].close()
    received = [rendezvous.receive(RELAY) for _ in range(2001)]
    assert [message.payload for message in received[:-1]] == [b"%d" % n for n in range(2000)]
    assert received[-1] == Message(KEYS.presence(R0), b"0")


def test_messages_put_before_leaving_are_delivered(rendezvous: Rendezvous) -> None:
    for n in range(2000):
        rendezvous[R0].put(KEYS.control(RECORDER, R0), b"%d" % n)
        rendezvous[R0].put(KEYS.body(WORLD, R0), b"%d" % n)
    rendezvous[R0].close()
    for name in (RECORDER, WORLD):
        assert [rendezvous.receive(name).payload for _ in range(2000)] == [b"%d" % n for n in range(2000)]


def test_receive_times_out_without_messages(rendezvous: Rendezvous) -> None:
    for name, end in rendezvous.ends.items():
        began = time.monotonic()
        assert end.receive(0) is None, name
        assert end.receive(0.05) is None, name
        assert time.monotonic() - began < 2


def test_a_message_to_an_absent_participant_is_dropped(rendezvous: Rendezvous) -> None:
    rendezvous[R1].close()
    rendezvous.receive(RELAY)
    rendezvous[RELAY].put(KEYS.control(R1, RELAY), b"anyone?")
    rendezvous[RELAY].put(KEYS.control("r7", RELAY), b"anyone?")
    rendezvous.ends[R1] = rendezvous.open(R1)
    assert rendezvous.receive(RELAY).payload == b"1"
    assert not any(rendezvous.everything_before_a_fence().values())


def test_a_closed_end_neither_sends_nor_receives(rendezvous: Rendezvous) -> None:
    for name, key in ((R0, KEYS.radio_tx(R0)), (WORLD, KEYS.control_tx(WORLD))):
        rendezvous[name].put(key, b"before")
        rendezvous[name].close()
        rendezvous[name].close()
        with pytest.raises(BusClosed):
            rendezvous[name].put(key, b"after")
        with pytest.raises(BusClosed):
            rendezvous[name].put(KEYS.control(RECORDER, name), b"after")
        with pytest.raises(BusClosed):
            rendezvous[name].receive(0)
        with pytest.raises(BusClosed):
            rendezvous[name].receive(SOON_S)
        assert [rendezvous.receive(RELAY).payload, rendezvous.receive(RELAY).payload] == [b"before", b"0"]


@pytest.mark.slow
def test_after_the_hub_leaves_its_last_messages_arrive_and_then_the_bus_is_closed(
    rendezvous: Rendezvous,
) -> None:
    for n in range(500):
        rendezvous[RELAY].put(KEYS.control(R0, RELAY), b"%d" % n)
    rendezvous[RELAY].close()
    received = []
    began = time.monotonic()
    with pytest.raises(BusClosed):
        while time.monotonic() - began < LOSS_S:
            message = rendezvous[R0].receive(LOSS_S)
            if message is not None:
                received.append(message.payload)
    assert received == [b"%d" % n for n in range(500)]


@pytest.mark.slow
def test_a_waiting_end_detects_the_loss_of_the_hub(rendezvous: Rendezvous) -> None:
    rendezvous[RELAY].close()
    began = time.monotonic()
    for name in (R0, R1, WORLD, RECORDER):
        with pytest.raises(BusClosed, match=name):
            while time.monotonic() - began < LOSS_S:
                rendezvous[name].receive()


def test_two_ends_of_one_name_cannot_share_an_inbox_in_memory() -> None:
    hub = MemoryHub("contract")
    hub.join(RELAY)
    hub.join(R0)
    with pytest.raises(ValueError, match="r0 is already on the bus"):
        hub.join(R0)


def test_a_relay_that_joins_last_learns_of_all_participants_in_memory() -> None:
    hub = MemoryHub("contract")
    hub.join(WORLD)
    hub.join(R0)
    relay = hub.join(RELAY)
    assert [relay.receive(), relay.receive(), relay.receive()] == [
        Message(KEYS.presence(WORLD), b"1"),
        Message(KEYS.presence(R0), b"1"),
        None,
    ]


def test_participants_with_messages_take_turns_in_memory() -> None:
    hub = MemoryHub("contract", [RELAY, WORLD, R0, R1])
    ends = {name: hub.join(name) for name in (R1, RELAY, RECORDER, R0, WORLD)}
    while ends[RELAY].receive() is not None:
        pass
    assert list(hub.in_turn()) == []
    ends[RELAY].put(KEYS.control(RECORDER, RELAY), b"")
    ends[RELAY].put(KEYS.control(R1, RELAY), b"")
    ends[RELAY].put(KEYS.control(WORLD, RELAY), b"")
    ends[RELAY].put(KEYS.control("r7", RELAY), b"unknown receiver")
    turns = []
    for name in hub.in_turn():
        turns.append(name)
        if name == WORLD:  # behind it in this round, and before it in the next one
            ends[WORLD].put(KEYS.body(R0, WORLD), b"")
            ends[WORLD].put(KEYS.control_tx(WORLD), b"")
        while ends[name].receive() is not None:
            pass
    assert turns == [WORLD, R0, R1, RECORDER]
    assert list(hub.in_turn()) == [RELAY]
    ends[RELAY].close()
    assert list(hub.in_turn()) == []


def test_waiting_messages_of_a_leaving_participant_are_dropped_in_memory() -> None:
    hub = MemoryHub("contract")
    relay, robot = hub.join(RELAY), hub.join(R0)
    relay.put(KEYS.control(R0, RELAY), b"")
    assert list(hub.in_turn()) == [RELAY, R0]
    robot.close()
    assert list(hub.in_turn()) == [RELAY]
