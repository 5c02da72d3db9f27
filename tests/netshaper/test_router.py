"""Routers: the robots that they may represent, and how router and hub detect each other's loss.

`test_access` has the tests of robots' rights at a router.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from typing import Any

import pytest
import zenoh

from deploy.dashboard.windows import free_port
from netshaper import access, certificates
from netshaper.hub import open_hub
from netshaper.router import Router
from protocol import keys as names
from protocol import numbering
from protocol.bus import Bus, BusClosed, Message
from protocol.keys import Keys
from protocol.zenoh_bus import Credential, join, open_connected, plain_config

pytestmark = pytest.mark.slow

KEYS = Keys("routed")
RELAY, WORLD = names.RELAY, names.WORLD
ROUTER = names.router("rack")
BLOCK = zenoh.CongestionControl.BLOCK
SOON_S = 30.0
"""Longest wait for a message that must arrive. On a busy machine, a connection takes seconds."""


class Routed:
    """A hub, the world, and robot r2 at it; r0 and r1 are to join through a router."""

    def __init__(self, stack: ExitStack) -> None:
        self.made = certificates.make(3, ["127.0.0.1"], routers={ROUTER: ["r0", "r1"]})
        hub = f"tls/127.0.0.1:{free_port()}"
        self.credentials = certificates.credentials(KEYS.run, hub, self.made)
        self.relay = open_hub(KEYS.run, hub, self.credentials, self.made[RELAY])
        self.ends: dict[str, Bus] = {RELAY: self.relay}
        stack.callback(self.relay.close)
        for name in (WORLD, "r2"):
            self.ends[name] = join(self.credentials[name])
            stack.callback(self.ends[name].close)
            assert self.receive(RELAY) == Message(KEYS.presence(name), b"1")
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.passwords = access.passwords(KEYS.run, self.endpoint, ["r0", "r1"])

    def receive(self, name: str) -> Message:
        message = self.ends[name].receive(SOON_S)
        assert message is not None, f"{name} received nothing"
        return message


@pytest.fixture
def routed() -> Iterator[Routed]:
    with ExitStack() as stack:
        yield Routed(stack)


def wait_for_subscriber(session: zenoh.Session, key: str) -> None:
    """Wait until a session knows a subscriber of a key: before, it sends no message with that key."""
    publisher: Any = session.declare_publisher(key)
    deadline = time.monotonic() + SOON_S
    while not publisher.matching_status.matching:
        assert time.monotonic() < deadline, f"the session knows no subscriber of {key}"
        time.sleep(0.01)
    publisher.undeclare()


def test_robots_behind_a_router_have_no_certificate_and_the_router_s_lists_them(routed: Routed) -> None:
    assert routed.made.keys() == {RELAY, WORLD, names.RECORDER, names.VIEW, "r2", ROUTER}
    assert routed.credentials[ROUTER].robots == ("r0", "r1")
    assert routed.credentials["r2"].robots == ()


@pytest.mark.parametrize("mode", ["client", "peer", "router"])
def test_a_rogue_with_a_router_s_certificate_represents_only_the_router_s_robots(
    routed: Routed, mode: str
) -> None:
    rogue = open_connected(plain_config(mode), routed.credentials[ROUTER])
    try:
        recording_bus = rogue.declare_subscriber("**", zenoh.handlers.FifoChannel(1000))
        tokens = [rogue.liveliness().declare_token(KEYS.alive(name)) for name in ("r2", ROUTER, "r1")]
        assert routed.receive(RELAY) == Message(KEYS.presence("r1"), b"1")
        own = KEYS.radio_tx("r0")
        wait_for_subscriber(rogue, own)
        for key in (
            KEYS.radio_tx("r2"),
            KEYS.control_tx("r2"),
            KEYS.control_tx(WORLD),
            KEYS.radio_rx("r2", "r0"),
            KEYS.body("r2", WORLD),
            KEYS.body(WORLD, "r2"),
            KEYS.control("r2", RELAY),
            f"murmur/{KEYS.run}/**",
        ):
            rogue.put(key, b"forged", congestion_control=BLOCK, allowed_destination=zenoh.Locality.REMOTE)
        numbered = numbering.Outgoing(numbering.new_session(), 1).number(b"its robot's")
        rogue.put(own, numbered, congestion_control=BLOCK)
        assert routed.receive(RELAY) == Message(own, b"its robot's")
        routed.relay.put(KEYS.radio_rx("r2", "r0"), b"secret")
        assert routed.receive("r2") == Message(KEYS.radio_rx("r2", "r0"), b"secret")
        routed.ends["r2"].put(KEYS.body(WORLD, "r2"), b"secret")
        assert routed.receive(WORLD) == Message(KEYS.body(WORLD, "r2"), b"secret")
        for name, end in routed.ends.items():
            assert end.receive(0) is None, name
        received = []
        while (sample := recording_bus.handler.try_recv()) is not None:
            received.append(str(sample.key_expr))
        assert set(received) <= {own}
        del tokens
    finally:
        rogue.close()  # type: ignore[no-untyped-call]


def test_a_second_process_of_a_robot_behind_a_router_is_refused_until_the_first_has_left(
    routed: Routed, monkeypatch: pytest.MonkeyPatch
) -> None:
    with closing(Router(routed.credentials[ROUTER], routed.endpoint, routed.passwords)):
        with closing(join(routed.passwords["r0"])), monkeypatch.context() as patch:
            assert routed.receive(RELAY) == Message(KEYS.presence("r0"), b"1")
            patch.setattr("protocol.zenoh_bus.CONNECT_S", 1.0)
            with pytest.raises(ConnectionError, match=r"^r0: another process has joined as r0"):
                join(routed.passwords["r0"])
        assert routed.receive(RELAY) == Message(KEYS.presence("r0"), b"0")
        with closing(join(routed.passwords["r0"])):
            assert routed.receive(RELAY) == Message(KEYS.presence("r0"), b"1")


def test_robots_reach_the_hub_through_a_router_and_both_detect_its_loss(routed: Routed) -> None:
    router = Router(routed.credentials[ROUTER], routed.endpoint, routed.passwords)
    with closing(join(routed.passwords["r0"])) as robot:
        assert routed.receive(RELAY) == Message(KEYS.presence("r0"), b"1")
        routed.ends[WORLD].put(KEYS.body("r0", WORLD), b"seen")
        assert robot.receive(SOON_S) == Message(KEYS.body("r0", WORLD), b"seen")
        router.close()
        assert routed.receive(RELAY) == Message(KEYS.presence("r0"), b"0")
        with pytest.raises(BusClosed, match=r"^r0: the connection to the hub was lost$"):
            robot.receive(SOON_S)


def test_a_router_ends_after_its_hub(routed: Routed) -> None:
    with closing(Router(routed.credentials[ROUTER], routed.endpoint, routed.passwords)) as router:
        serving = threading.Thread(target=router.serve)
        serving.start()
        time.sleep(0.3)
        assert serving.is_alive()
        routed.relay.close()
        serving.join(SOON_S)
        assert not serving.is_alive()


def test_a_router_that_the_hub_refuses_reports_it(routed: Routed, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("protocol.zenoh_bus.CONNECT_S", 0.4)
    stranger = certificates.make(3, ["127.0.0.1"], routers={ROUTER: ["r0"]})[ROUTER]
    hub = routed.credentials[ROUTER].hub
    wrong = Credential(KEYS.run, ROUTER, hub, certificate=stranger, robots=("r0",))
    with pytest.raises(
        ConnectionError, match=r"^router@rack: cannot join at tls/127.* certificate is not valid"
    ):
        Router(wrong, routed.endpoint, routed.passwords)
