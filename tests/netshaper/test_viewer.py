"""The viewer at relay and bus: it is announced, the run never waits for it, and its messages are rejected."""

from __future__ import annotations

import multiprocessing
import os
import secrets
import signal
import time
from pathlib import Path
from typing import Any

import pytest

from deploy.dashboard.windows import free_port
from netshaper import access
from netshaper.hub import open_hub
from netshaper.process import RelayNode
from netshaper.settings import RadioSettings
from protocol import keys as names
from protocol.keys import Keys, may_be_dropped
from protocol.memory_bus import MemoryBus, MemoryHub
from protocol.message_codec import pack, unpack
from protocol.messages import Begin, End, ErrorReport, Lost, Shutdown, Stop, Watched
from protocol.zenoh_bus import join


class Team:
    """A relay on the memory bus, and its participants."""

    def __init__(self, *order: str) -> None:
        self.hub = MemoryHub("test")
        self.bus = self.hub.join(names.RELAY)
        self.relay = RelayNode(self.bus, self.hub.keys, RadioSettings(1, 0, 100.0))
        self.ends = {name: self.come(name) for name in order}

    def come(self, name: str) -> MemoryBus:
        end = self.hub.join(name)
        self.work()
        return end

    def work(self) -> None:
        while (message := self.bus.receive()) is not None:
            self.relay.handle(message)

    def received(self, name: str) -> list[Any]:
        messages = []
        while (message := self.ends[name].receive()) is not None:
            messages.append(unpack(message.payload))
        return messages


def test_a_run_begins_without_a_viewer_and_announces_one_that_joins_late() -> None:
    team = Team(names.RECORDER, names.WORLD, "r0")
    assert team.received(names.WORLD) == [Begin()]
    team.ends[names.VIEW] = team.come(names.VIEW)
    assert team.received(names.WORLD) == team.received("r0") == [Watched(here=True)]
    assert team.received(names.RECORDER) == []
    team.ends[names.VIEW].close()
    team.work()
    assert team.received(names.WORLD) == team.received("r0") == [Watched(here=False)]


def test_participants_that_join_after_the_viewer_are_notified() -> None:
    team = Team(names.VIEW, names.WORLD, "r0", names.RECORDER)
    assert team.received(names.WORLD) == [Watched(here=True), Begin()]
    assert team.received("r0") == [Watched(here=True)]
    assert team.received(names.RECORDER) == []


def test_the_viewer_receives_the_recorder_s_reports() -> None:
    team = Team(names.VIEW, names.WORLD, "r0", names.RECORDER)
    team.ends["r0"].close()
    team.work()
    lost = Lost(0, "its process ended")
    assert team.received(names.RECORDER) == team.received(names.VIEW) == [lost]
    team.ends[names.WORLD].put(team.hub.keys.control_tx(names.WORLD), pack(End(3, "explored", 0)))
    team.work()
    assert team.received(names.RECORDER) == team.received(names.VIEW) == [End(3, "explored", 0)]


def test_the_relay_ends_though_the_viewer_stays() -> None:
    team = Team(names.VIEW, names.WORLD, "r0", names.RECORDER)
    team.ends[names.RECORDER].put(team.hub.keys.control_tx(names.RECORDER), pack(Shutdown()))
    team.work()
    assert team.received(names.VIEW) == [Shutdown()]
    for name in (names.WORLD, "r0", names.RECORDER):
        assert not team.relay.done
        team.ends[name].close()
        team.work()
    assert team.relay.done


def test_messages_of_a_viewer_are_protocol_errors() -> None:
    team = Team(names.VIEW, names.WORLD, "r0", names.RECORDER)
    team.received(names.WORLD)
    team.ends[names.VIEW].put(team.hub.keys.control_tx(names.VIEW), pack(Stop("I am bored")))
    team.work()
    assert team.received(names.WORLD) == []
    (fault,) = team.received(names.RECORDER)
    assert fault == ErrorReport(names.VIEW, "message at byte 0: view may send no message here")


def test_only_messages_to_the_viewer_may_be_dropped() -> None:
    keys = Keys("run")
    assert may_be_dropped(keys.control(names.VIEW, "r0"))
    for key in (
        keys.control(names.RECORDER, "r0"), keys.control("r1", names.RELAY), keys.body("r1", names.WORLD),
        keys.radio_rx("r1", "r0"), keys.radio_tx("r1"), keys.control_tx(names.VIEW),
    ):  # fmt: skip
        assert not may_be_dropped(key)


def test_the_hub_s_rules_let_a_viewer_send_nothing() -> None:
    rules = access.rules(Keys("run"), {name: [name] for name in access.participants(2)})
    (policy,) = (policy for policy in rules["policies"] if policy["subjects"] == [names.VIEW])
    allowed = [rule for rule in rules["rules"] if rule["id"] in policy["rules"]]
    assert {(rule["messages"][0], rule["flows"][0]) for rule in allowed} == {
        ("put", "egress"),
        ("declare_subscriber", "ingress"),
        ("liveliness_token", "ingress"),
    }
    assert {key for rule in allowed for key in rule["key_exprs"]} == {
        "murmur/run/*/rx/view/**",
        "murmur/run/alive/view",
    }


def be_viewer(credential: access.Credential, ready: Any) -> None:
    bus = join(credential)
    ready.send(True)
    while bus.receive() is not None:
        pass


@pytest.mark.parametrize("stopped", [False, True])
def test_reports_to_a_viewer_that_hangs_delay_no_participant(stopped: bool) -> None:
    run, endpoint = secrets.token_hex(4), f"tcp/127.0.0.1:{free_port()}"
    keys, credentials = Keys(run), access.issue(run, endpoint, 1)
    hub = open_hub(run, endpoint, credentials)
    robot = join(credentials["r0"])
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=be_viewer, args=(credentials[names.VIEW], there))
    process.start()
    try:
        assert here.poll(30)
        pid = process.pid
        assert pid is not None
        if stopped:
            os.kill(pid, signal.SIGSTOP)
        began = time.monotonic()
        for round_ in range(200):
            robot.put(keys.control(names.VIEW, "r0"), os.urandom(200_000))
            robot.put(keys.control_tx("r0"), str(round_).encode())
        received = []
        while len(received) < 200:
            message = hub.receive(10)
            assert message is not None
            if "/control/tx/" in message.key:
                received.append(int(message.payload))
        took = time.monotonic() - began
    finally:
        process.kill()
        process.join()
        robot.close()
        hub.close()
    assert received == list(range(200))
    assert took < 4  # where it waits, zenoh gives a stopped peer up after 5 s


def test_credentials_are_for_the_viewer_as_well(tmp_path: Path) -> None:
    assert names.VIEW in access.issue("run", "tcp/127.0.0.1:1", 3)
    assert access.participants(0) == [names.WORLD, names.RECORDER, names.VIEW]
