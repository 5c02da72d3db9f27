"""Access control, with a rogue that holds the valid credential of robot r1 and speaks plain Zenoh.

The hub passes only messages that r1 may send or receive. Each test also shows that the channel works for authorized
participants. All tests run twice: at the hub, and at a router through which robots join.
"""

from __future__ import annotations

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
from protocol.bus import Bus, Message
from protocol.keys import Keys
from protocol.zenoh_bus import Credential, insert, join, plain_config

pytestmark = pytest.mark.slow

KEYS = Keys("guarded")
RELAY, WORLD, RECORDER = names.RELAY, names.WORLD, names.RECORDER
ROUTER = names.router("rack")
SOON_S = 30.0
"""Longest wait for a message that must arrive. On a busy machine, a connection takes seconds."""
MODES = ("client", "peer", "router")
BLOCK = zenoh.CongestionControl.BLOCK

FORBIDDEN = [
    KEYS.radio_tx("r0"),
    KEYS.control_tx("r0"),
    KEYS.control_tx(WORLD),
    KEYS.control_tx(RECORDER),
    KEYS.radio_rx("r0", "r1"),
    KEYS.radio_rx("r0", "r2"),
    KEYS.control("r0", RELAY),
    KEYS.control("r0", "r1"),
    KEYS.control("r0", "tick"),
    KEYS.control(WORLD, RELAY),
    KEYS.control(RECORDER, RELAY),
    KEYS.control(RECORDER, WORLD),
    KEYS.control(RECORDER, "r0"),
    KEYS.body("r0", WORLD),
    KEYS.body("r0", "r1"),
    KEYS.body(WORLD, "r0"),
    KEYS.presence("r0"),
    KEYS.presence("tick"),
    KEYS.alive("r0"),
    KEYS.radio_tx("r1") + "/more",
    f"murmur/{KEYS.run}/radio/tx/*/r0",
    f"murmur/{KEYS.run}/*/tx/r1/r0",
    f"murmur/{KEYS.run}/radio/tx/r1/**",
    f"murmur/{KEYS.run}/*/rx/r0/**",
    f"murmur/{KEYS.run}/radio/rx/*/r1",
    f"murmur/{KEYS.run}/body/rx/*/r1",
    f"murmur/{KEYS.run}/**",
    "**",
]


class Guarded:
    """A run of three robots, the second of them a rogue; with a router, all of them join through it."""

    def __init__(self, stack: ExitStack, *, routed: bool) -> None:
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.credentials = access.issue(KEYS.run, self.endpoint, 3)
        if routed:
            self.ends = {RELAY: self._hub_behind_router(stack)}
        else:
            self.ends = {RELAY: open_hub(KEYS.run, self.endpoint, self.credentials)}
        stack.callback(self.ends[RELAY].close)
        for name in (WORLD, RECORDER, "r0", "r2"):
            self.ends[name] = join(self.credentials[name])
            stack.callback(self.ends[name].close)
        for _ in range(4):
            self.receive(RELAY)
        self._stack = stack

    def _hub_behind_router(self, stack: ExitStack) -> Bus:
        """A hub that requires certificates, and a router at this run's endpoint."""
        hub, routers = f"tls/127.0.0.1:{free_port()}", {ROUTER: ["r0", "r1", "r2"]}
        made = certificates.make(3, ["127.0.0.1"], routers=routers)
        issued = certificates.credentials(KEYS.run, hub, made)
        relay = open_hub(KEYS.run, hub, issued, made[RELAY])
        robots = {name: self.credentials[name] for name in routers[ROUTER]}
        self.credentials |= issued
        stack.callback(Router(issued[ROUTER], self.endpoint, robots).close)
        return relay

    def rogue(self, mode: str) -> zenoh.Session:
        """Open a session with r1's credential; return once the relay receives its messages."""
        session = zenoh.open(rogue_config(mode, self.endpoint, "r1", self.credentials["r1"].password, 5000))
        self._stack.callback(close, session)
        deadline = time.monotonic() + SOON_S
        relay = self.ends[RELAY]
        while relay.receive(0) is None:
            assert time.monotonic() < deadline, "the rogue's permitted messages do not arrive"
            session.put(KEYS.radio_tx("r1"), b"knock", congestion_control=BLOCK)
            time.sleep(0.01)
        session.put(KEYS.radio_tx("r1"), b"I am in", congestion_control=BLOCK)
        while self.receive(RELAY).payload != b"I am in":
            pass
        return session

    def receive(self, name: str) -> Message:
        message = self.ends[name].receive(SOON_S)
        assert message is not None, f"{name} received nothing"
        return message

    def legitimate_traffic(self) -> list[tuple[str, Message]]:
        """Use every channel as intended; return the message of each receiver."""
        received = []
        for sender, key, receiver in [
            (RELAY, KEYS.radio_rx("r0", "r2"), "r0"),
            (RELAY, KEYS.control("r0", RELAY), "r0"),
            (WORLD, KEYS.body("r0", WORLD), "r0"),
            (RELAY, KEYS.control(WORLD, RELAY), WORLD),
            (RELAY, KEYS.control(RECORDER, RELAY), RECORDER),
            ("r0", KEYS.radio_tx("r0"), RELAY),
            ("r0", KEYS.control_tx("r0"), RELAY),
            ("r0", KEYS.body(WORLD, "r0"), WORLD),
            ("r0", KEYS.control(RECORDER, "r0"), RECORDER),
        ]:
            self.ends[sender].put(key, b"secret")
            message = self.receive(receiver)
            assert message == Message(key, b"secret")
            received.append((receiver, message))
        return received

    def no_other_message_arrived(self) -> None:
        """Check that all inboxes are empty: each end receives the next legitimate message first."""
        self.legitimate_traffic()
        for name, end in self.ends.items():
            assert end.receive(0) is None, name


def rogue_config(
    mode: str, endpoint: str, user: str | None, password: str | None, timeout_ms: int = 300
) -> zenoh.Config:
    config = plain_config(mode)
    insert(config, "connect/endpoints", [endpoint])
    insert(config, "connect/timeout_ms", timeout_ms)
    insert(config, "connect/exit_on_failure", True)
    if mode != "client":
        insert(config, "listen/endpoints", [f"tcp/127.0.0.1:{free_port()}"])
    if user is not None:
        insert(config, "transport/auth/usrpwd/user", user)
        insert(config, "transport/auth/usrpwd/password", password)
    return config


def close(session: zenoh.Session) -> None:
    session.close()  # type: ignore[no-untyped-call]


def undeclare(declared: Any) -> None:
    declared.undeclare()


def drained(handler: Any) -> list[Any]:
    found = []
    while (item := handler.try_recv()) is not None:
        found.append(item)
    return found


@pytest.fixture(params=[False, True], ids=["hub", "router"])
def guarded(request: pytest.FixtureRequest) -> Iterator[Guarded]:
    with ExitStack() as stack:
        yield Guarded(stack, routed=request.param)


@pytest.mark.parametrize("mode", MODES)
def test_a_robot_may_use_its_own_channels_with_any_client(guarded: Guarded, mode: str) -> None:
    rogue = guarded.rogue(mode)
    inbox = rogue.declare_subscriber(KEYS.inbox("r1"), zenoh.handlers.FifoChannel(100))
    token = rogue.liveliness().declare_token(KEYS.alive("r1"))
    assert guarded.receive(RELAY) == Message(KEYS.presence("r1"), b"1")
    for key, receiver in [
        (KEYS.radio_tx("r1"), RELAY),
        (KEYS.control_tx("r1"), RELAY),
        (KEYS.body(WORLD, "r1"), WORLD),
        (KEYS.control(RECORDER, "r1"), RECORDER),
    ]:
        rogue.put(key, b"mine", congestion_control=BLOCK)
        assert guarded.receive(receiver) == Message(key, b"mine")
    guarded.ends[RELAY].put(KEYS.control("r1", RELAY), b"yours")
    assert inbox.recv().payload.to_bytes()[numbering.HEAD.size :] == b"yours"
    undeclare(token)
    assert guarded.receive(RELAY) == Message(KEYS.presence("r1"), b"0")


@pytest.mark.parametrize("mode", MODES)
def test_messages_that_a_rogue_puts_under_other_names_reach_no_participant(
    guarded: Guarded, mode: str
) -> None:
    rogue = guarded.rogue(mode)
    for key in FORBIDDEN:
        rogue.put(key, b"forged", congestion_control=BLOCK)
        publisher = rogue.declare_publisher(key, congestion_control=BLOCK)
        publisher.put(b"forged")
    # On the same connection, after all messages above: once it arrives, none of them is on its way.
    rogue.put(KEYS.radio_tx("r1"), b"mine", congestion_control=BLOCK)
    assert guarded.receive(RELAY) == Message(KEYS.radio_tx("r1"), b"mine")
    guarded.no_other_message_arrived()


@pytest.mark.parametrize("mode", MODES)
def test_deletions_of_a_rogue_have_no_effect(guarded: Guarded, mode: str) -> None:
    rogue = guarded.rogue(mode)
    for key in [*FORBIDDEN, KEYS.radio_tx("r1"), KEYS.body(WORLD, "r1"), KEYS.control_tx("r1")]:
        rogue.delete(key, congestion_control=BLOCK)
    rogue.put(KEYS.control_tx("r1"), b"mine", congestion_control=BLOCK)
    assert guarded.receive(RELAY) == Message(KEYS.control_tx("r1"), b"mine")
    guarded.no_other_message_arrived()


@pytest.mark.parametrize("mode", MODES)
def test_a_rogue_that_subscribes_to_all_keys_receives_only_its_own_messages(
    guarded: Guarded, mode: str
) -> None:
    rogue = guarded.rogue(mode)
    ears = [
        rogue.declare_subscriber(key, zenoh.handlers.FifoChannel(1000))
        for key in [
            *FORBIDDEN,
            "murmur/**",
            f"murmur/{KEYS.run}/*/rx/**",
            f"murmur/{KEYS.run}/*/tx/**",
            "*/**",
        ]
    ]
    own = rogue.declare_subscriber(KEYS.inbox("r1"), zenoh.handlers.FifoChannel(1000))
    token = rogue.liveliness().declare_token(KEYS.alive("r1"))
    assert guarded.receive(RELAY) == Message(KEYS.presence("r1"), b"1")
    guarded.legitimate_traffic()
    guarded.ends[RELAY].put(KEYS.control("r1", RELAY), b"yours")
    guarded.ends[WORLD].put(KEYS.body("r1", WORLD), b"yours")
    assert {str(own.recv().key_expr) for _ in range(2)} == {
        KEYS.control("r1", RELAY),
        KEYS.body("r1", WORLD),
    }
    for recording_bus in ears:
        recorded_for = {str(sample.key_expr) for sample in drained(recording_bus.handler)}
        assert recorded_for <= {KEYS.control("r1", RELAY), KEYS.body("r1", WORLD)}
    undeclare(token)


@pytest.mark.parametrize("mode", MODES)
def test_a_rogue_cannot_announce_others(guarded: Guarded, mode: str) -> None:
    rogue = guarded.rogue(mode)
    tokens = [
        rogue.liveliness().declare_token(key)
        for key in (
            KEYS.alive("r0"),
            KEYS.alive("r7"),
            KEYS.alive(WORLD),
            KEYS.alive(RELAY),
            KEYS.alive("r1") + "/x",
            f"murmur/{KEYS.run}/alive/x/r0",
        )
    ]
    # The relay receives its own name, after the hub has rejected all others.
    tokens.append(rogue.liveliness().declare_token(KEYS.alive("r1")))
    assert guarded.receive(RELAY) == Message(KEYS.presence("r1"), b"1")
    guarded.ends["r0"].close()
    assert guarded.receive(RELAY) == Message(KEYS.presence("r0"), b"0")
    guarded.ends["r0"] = join(guarded.credentials["r0"])
    assert guarded.receive(RELAY) == Message(KEYS.presence("r0"), b"1")
    for token in tokens:
        undeclare(token)
    assert guarded.receive(RELAY) == Message(KEYS.presence("r1"), b"0")
    guarded.no_other_message_arrived()
    guarded.ends["r0"].close()


@pytest.mark.parametrize("mode", MODES)
def test_a_rogue_cannot_list_participants(guarded: Guarded, mode: str) -> None:
    rogue = guarded.rogue(mode)
    seen = rogue.liveliness().declare_subscriber(
        KEYS.alive("*"), zenoh.handlers.FifoChannel(100), history=True
    )
    guarded.ends["r2"].close()
    assert guarded.receive(RELAY) == Message(KEYS.presence("r2"), b"0")
    found = rogue.liveliness().get(KEYS.alive("*"), zenoh.handlers.FifoChannel(100), timeout=0.3)
    assert iter_replies(found) == []
    assert drained(seen.handler) == []


def iter_replies(handler: Any) -> list[Any]:
    found = []
    while True:
        try:
            found.append(handler.recv())
        except zenoh.ZError:
            return found


@pytest.mark.parametrize("mode", MODES)
def test_a_rogue_can_neither_send_nor_answer_queries(guarded: Guarded, mode: str) -> None:
    rogue = guarded.rogue(mode)
    asked: list[str] = []

    def answer(query: zenoh.Query) -> None:
        asked.append(str(query.key_expr))
        query.reply(query.key_expr, b"forged")

    queryables = [rogue.declare_queryable(key, answer) for key in ("**", KEYS.inbox("r0"), KEYS.inbox("r1"))]
    hub: Any = guarded.ends[RELAY]
    served = hub._session.declare_queryable(
        f"murmur/{KEYS.run}/secret", lambda query: query.reply(query.key_expr, b"!")
    )
    for key in ("**", f"murmur/{KEYS.run}/**", f"murmur/{KEYS.run}/secret", "@/**"):
        replies = iter_replies(rogue.get(key, zenoh.handlers.FifoChannel(100), timeout=0.3))
        foreign = [r for r in replies if r.ok is not None and r.ok.payload.to_bytes() != b"forged"]
        # Under @ it can see only its own session's status.
        assert all(str(rogue.info.zid()) in str(r.ok.key_expr) for r in foreign)
    asked.clear()
    for key in (KEYS.radio_rx("r0", "r2"), KEYS.radio_rx("r1", "r0")):
        assert iter_replies(hub._session.get(key, zenoh.handlers.FifoChannel(100), timeout=0.3)) == []
    assert asked == []
    assert (
        len(iter_replies(hub._session.get(f"murmur/{KEYS.run}/secret", zenoh.handlers.FifoChannel(9)))) == 1
    )
    for queryable in (*queryables, served):
        undeclare(queryable)


@pytest.mark.parametrize(
    ("mode", "user", "password"),
    [
        *((mode, user, password) for mode in MODES for user, password in [("r1", "wrong"), (None, None)]),
        ("client", "r1", ""),
        ("client", "unknown", "x"),
        ("client", RELAY, ""),
    ],
)
def test_the_hub_refuses_clients_without_a_valid_credential(
    guarded: Guarded, mode: str, user: str | None, password: str | None
) -> None:
    with ExitStack() as stack:
        try:
            rogue = zenoh.open(rogue_config(mode, guarded.endpoint, user, password))
        except zenoh.ZError:
            guarded.no_other_message_arrived()
            return
        stack.callback(close, rogue)
        recording_bus = rogue.declare_subscriber("**", zenoh.handlers.FifoChannel(1000))
        token = rogue.liveliness().declare_token(KEYS.alive("r1"))
        for key in [*FORBIDDEN, KEYS.radio_tx("r1")]:
            rogue.put(key, b"forged", allowed_destination=zenoh.Locality.REMOTE)
        time.sleep(0.2)
        assert list(rogue.info.routers_zid()) == []
        guarded.no_other_message_arrived()
        assert drained(recording_bus.handler) == []
        undeclare(token)


def test_a_password_of_another_robot_is_refused_with_the_reason(
    guarded: Guarded, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("protocol.zenoh_bus.CONNECT_S", 0.5)
    wrong = Credential(KEYS.run, "r1", guarded.endpoint, guarded.credentials["r0"].password)
    with pytest.raises(
        ConnectionError, match=r"r1: cannot join at tcp/127.* a program answers, but the password"
    ):
        join(wrong)
    absent = Credential(KEYS.run, "r1", f"tcp/127.0.0.1:{free_port()}", "x")
    with pytest.raises(ConnectionError, match=r"r1: cannot join .* no hub answers \(Connection refused\)"):
        join(absent)


@pytest.mark.parametrize("name", ["r0", WORLD])
def test_a_second_process_of_a_name_is_refused_until_the_first_has_left(
    guarded: Guarded, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("protocol.zenoh_bus.CONNECT_S", 0.5)
        with pytest.raises(ConnectionError, match=f"^{name}: another process has joined as {name}; start "):
            join(guarded.credentials[name])
    guarded.legitimate_traffic()
    guarded.ends[name].close()
    assert guarded.receive(RELAY) == Message(KEYS.presence(name), b"0")
    with closing(join(guarded.credentials[name])):
        assert guarded.receive(RELAY) == Message(KEYS.presence(name), b"1")


def test_two_hubs_cannot_share_an_endpoint(guarded: Guarded) -> None:
    with pytest.raises(ConnectionError, match=r"cannot listen at \S+: Address already in use$"):
        open_hub("other", guarded.endpoint, access.issue("other", guarded.endpoint, 1))


def test_each_run_has_new_credentials() -> None:
    one, other = (access.issue("run", "tcp/127.0.0.1:7447", 3) for _ in range(2))
    passwords = [credential.password for credential in [*one.values(), *other.values()]]
    assert len(set(passwords)) == len(passwords)
    assert all(len(password) >= 20 for password in passwords)


def test_a_credential_of_one_run_does_not_open_the_next(guarded: Guarded) -> None:
    old = access.issue(KEYS.run, guarded.endpoint, 3)["r1"]
    with pytest.raises(zenoh.ZError):
        zenoh.open(rogue_config("client", guarded.endpoint, old.name, old.password))


def test_each_participant_may_put_and_receive_only_under_its_own_name() -> None:
    rules = access.rules(KEYS, {name: [name] for name in access.participants(2)})
    assert rules["default_permission"] == "deny"
    assert {subject["id"] for subject in rules["subjects"]} == set(access.participants(2))
    for rule in rules["rules"]:
        assert rule["permission"] == "allow"
        assert rule["messages"][0] in ("put", "declare_subscriber", "liveliness_token")
        if rule["id"].startswith("r0-") and rule["flows"] == ["ingress"]:
            assert all("r0" in key.split("/") for key in rule["key_exprs"])
