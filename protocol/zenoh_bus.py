"""The bus between processes and hosts: Eclipse Zenoh with one hub; all other participants are clients.

The hub is the relay's own session: it routes what its access control allows (`netshaper.access`) and nothing
else. A session has one subscription, read in the main loop. A thread sends a tick to it four times a second, so
that a client detects the loss of its hub, and one whenever a wait times out.
"""

from __future__ import annotations

import base64
import contextlib
import json
import os
import re
import socket
import threading
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec

from protocol import keys as names
from protocol.alarm import Alarm
from protocol.bus import BusClosed, Message
from protocol.files import read_file
from protocol.keys import Keys
from protocol.numbering import KEPT_BY_ROBOT, KEPT_FOR_ROBOT, Incoming, Outgoing, is_numbered, new_session

# One executor for most of zenoh's tasks is faster. Sending keeps its own: on a single executor, a hub that routes
# to a client which has just been killed deadlocks (`send_along` is for processes that route nothing). Zenoh reads this
# when the first session opens.
os.environ["ZENOH_RUNTIME"] = "(rx: (handover: app), acc: (handover: app), net: (handover: app))"
import zenoh

TICK_S = 0.25
QUEUE = 1 << 16
CONNECT_S = 10.0
PROBE_S = 2.0
"""Time limit for a connection that shows whether a program listens at all."""
POLL_S = 0.002
OTHER_HOST = (62, 64)
"""OpenSSL's codes for a certificate that names another host, or another IP address (X509_V_ERR_...)."""
RECONNECT_S = 3.0
"""Time limit for a robot's connection to be restored after it was cut. The robot itself waits a second longer."""
LEASE_MS, KEEP_ALIVE_MS = 10_000, 100
BATCH_BYTES = 8192
"""Maximum bytes that are sent at once between hosts: on a slow link, the lease must not end while these arrive."""


@dataclass(frozen=True)
class Certificate:
    """Certificates for mutual TLS, in PEM: of the run's authority and of the participant, with its private key."""

    authority: str
    certificate: str
    key: str


@dataclass(frozen=True)
class Credential:
    """Data for joining a run: address of the hub, name of the participant, its password or certificate.

    Attributes
    ----------
    robots : tuple of str
        Of a router (`netshaper.router`): the names of the robots that join through it.
    code : str
        Digest of the relay's code, for processes that are started by hand; empty: not to be compared.
    map : str
        Digest of the relay's map, likewise.
    """

    run: str
    name: str
    hub: str
    password: str = ""
    certificate: Certificate | None = None
    robots: tuple[str, ...] = ()
    code: str = ""
    map: str = ""

    def write(self, path: Path) -> None:
        """Write a JSON file that only its owner can read."""
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            json.dump(asdict(self), file, indent=2)

    @classmethod
    def read(cls, path: Path) -> Credential:
        """Read a credential file; ValueError if it is unreadable or malformed."""
        try:
            data = read_file(path)
        except OSError as error:
            raise ValueError(f"credential {path}: {error.strerror}") from None
        return cls.parse(data, f"credential {path}")

    @classmethod
    def parse(cls, data: str | bytes, where: str = "credential") -> Credential:
        """Read a credential from JSON; ValueError, whose text starts with `where`, if it is malformed."""
        needs = (
            f"{where}: needs the strings run, name, hub, password, or a certificate instead of the password"
        )
        try:
            found = msgspec.json.decode(data, type=cls)
        except msgspec.ValidationError as error:
            raise ValueError(f"{needs} ({error})") from None
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            raise ValueError(f"{where}: not JSON ({error})") from None
        if found.certificate is None and not found.password:
            raise ValueError(needs)
        Keys(found.run)
        port = re.fullmatch(r"(?:tcp|tls)/\S+:([0-9]{1,5})", found.hub)
        if port is None or not 0 < int(port[1]) < 1 << 16:
            raise ValueError(f"{where}: hub = {found.hub!r}: must be as tcp/127.0.0.1:7447")
        if not all(map(names.is_robot, found.robots)):
            raise ValueError(f"{where}: robots = {list(found.robots)!r}: must be names of robots, as r0")
        return found


class ZenohBus:
    """One participant's end of the bus; `join` and `netshaper.hub.open_hub` make it."""

    def __init__(self, session: zenoh.Session, keys: Keys, name: str) -> None:
        self._session = session
        self._keys = keys
        self._name = name
        self._is_hub = name == names.RELAY
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._session_number = new_session()
        self._outgoing: dict[str, Outgoing] = {}
        self._incoming: dict[str, Incoming] = {}
        self._misses = int((RECONNECT_S + 1) / TICK_S) if names.is_robot(name) else 1
        """Consecutive ticks without a connection that a participant tolerates."""
        self._closing = threading.Event()
        self._hub_gone = False
        self._tick_key = keys.presence("tick") if self._is_hub else keys.control(name, "tick")
        self._subscriber = session.declare_subscriber(keys.inbox(name), zenoh.handlers.FifoChannel(QUEUE))
        self._inbox = self._subscriber.handler
        # After the subscription: a participant that sees the token can rely on its messages being received.
        self._watch: Any = None
        self._token: Any = None
        if self._is_hub:
            self._watch = session.liveliness().declare_subscriber(
                keys.alive("*"), self._report_presence, history=True
            )
        else:
            self._token = session.liveliness().declare_token(keys.alive(name))
        self._alarm = Alarm()
        self._ticker = threading.Thread(target=self._tick, name=f"{name}-ticks", daemon=True)
        self._ticker.start()

    @property
    def misses_messages(self) -> bool:
        """Whether messages to this name have gone to an earlier process, so that this process lacks them."""
        return any(incoming.first for incoming in self._incoming.values())

    def put(self, key: str, payload: bytes) -> None:
        """Send `payload` to the participant whose inbox contains `key`; wait while the network is congested.

        Messages to a viewer are dropped instead (`protocol.keys.may_be_dropped`).
        """
        if self._closing.is_set():
            raise BusClosed(f"{self._name}: this end of the bus is closed")
        publisher = self._publishers.get(key)
        if publisher is None:
            drop, block = zenoh.CongestionControl.DROP, zenoh.CongestionControl.BLOCK
            control = drop if names.may_be_dropped(key) else block
            publisher = self._session.declare_publisher(key, congestion_control=control)
            self._publishers[key] = publisher
            if is_numbered(key):
                kept = KEPT_BY_ROBOT if names.is_robot(self._name) else KEPT_FOR_ROBOT
                self._outgoing[key] = Outgoing(self._session_number, kept)
        outgoing = self._outgoing.get(key)
        publisher.put(payload if outgoing is None else outgoing.number(payload))

    def resend(self, receiver: str | None = None) -> None:
        """Send the last messages again, to one receiver or to all; receivers ignore those that have arrived.

        Relay and world call this after a robot's connection was restored, and the robot itself.
        """
        for key, outgoing in self._outgoing.items():
            if receiver is None or names.parts(key)[2] == receiver:
                for numbered in outgoing.kept:
                    self._publishers[key].put(numbered)

    def receive(self, timeout_s: float | None = None) -> Message | None:
        """Wait for the next message, at most `timeout_s` seconds; see `protocol.bus.Bus`."""
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            if self._closing.is_set():
                raise BusClosed(f"{self._name}: this end of the bus is closed")
            if deadline is not None:
                self._alarm.set(deadline)
            try:
                sample = self._inbox.recv() if timeout_s != 0 else self._inbox.try_recv()
            except zenoh.ZError as error:
                raise BusClosed(f"{self._name}: the bus is closed ({error})") from None
            if sample is None:
                return None
            key = str(sample.key_expr)
            if key != self._tick_key:
                payload = self._taken(key, sample.payload.to_bytes())
                if payload is None:
                    continue
                return Message(key, payload)
            if self._hub_gone:
                raise BusClosed(f"{self._name}: the connection to the hub was lost")
            if deadline is not None and time.monotonic() >= deadline:
                return None

    def close(self) -> None:
        """Leave the bus."""
        if not self._closing.is_set():
            self._closing.set()
            self._alarm.close()
            self._ticker.join()
            for part in (self._watch, self._token, self._subscriber):
                if part is not None:
                    part.undeclare()
            self._session.close()  # type: ignore[no-untyped-call]

    def _taken(self, key: str, payload: bytes) -> bytes | None:
        """Return a message without its number; None if it is to be ignored."""
        if not is_numbered(key):
            return payload
        incoming = self._incoming.get(key)
        if incoming is None:
            incoming = self._incoming[key] = Incoming()
        return incoming.accept(payload)

    def _report_presence(self, sample: zenoh.Sample) -> None:
        """Put a liveliness change into the inbox as a message (runs on a thread of zenoh)."""
        if not self._closing.is_set():
            name = str(sample.key_expr).rsplit("/", 1)[-1]
            self._session.put(
                self._keys.presence(name), b"1" if sample.kind == zenoh.SampleKind.PUT else b"0"
            )

    def _tick(self) -> None:
        missing, due = 0, time.monotonic() + TICK_S
        while True:
            self._alarm.sleep(due)
            if self._closing.is_set():
                break
            now = time.monotonic()
            if now >= due:
                due = now + TICK_S
                missing = 0 if self._is_hub or self._session.info.routers_zid() else missing + 1
                self._hub_gone = self._hub_gone or missing > self._misses
            self._session.put(self._tick_key, b"", allowed_destination=zenoh.Locality.SESSION_LOCAL)


def join(credential: Credential) -> ZenohBus:
    """Join a run as a client.

    Raises
    ------
    ConnectionError
        The hub does not answer, or refuses the credential, or another process has joined with it.
    """
    session, keys = open_connected(plain_config("client"), credential), Keys(credential.run)
    if credential.name != names.VIEW and (problem := _obstacle(session, keys, credential)):
        session.close()  # type: ignore[no-untyped-call]
        raise ConnectionError(f"{credential.name}: {problem}")
    return ZenohBus(session, keys, credential.name)


def _obstacle(session: zenoh.Session, keys: Keys, credential: Credential) -> str:
    """Return why this session cannot join; empty if it can.

    It can join if it reaches the relay, and if no other process has this name. It waits up to `CONNECT_S` for each; the
    hub notices within that time that a process of this name has died. The hub answers in order: once this session knows
    the relay's subscriptions, it also knows those of other processes of its name.
    """
    with _publisher(session, keys.control(credential.name, names.RELAY)) as own:
        if not _reaches_relay(session, keys.control_tx(credential.name)):
            return f"timed out: no relay at {credential.hub} within {CONNECT_S:g} s"
        if not _matches(own, wanted=False):
            return f"another process has joined as {credential.name}; start each participant once"
    return ""


@contextlib.contextmanager
def _publisher(session: zenoh.Session, key: str) -> Iterator[Any]:
    """Declare a publisher: only for a declared key does a session know its subscribers."""
    publisher: Any = session.declare_publisher(key)
    try:
        yield publisher
    finally:
        publisher.undeclare()


def _matches(publisher: Any, *, wanted: bool) -> bool:
    """Wait until a publisher has a subscriber, or has none; return whether that is so."""
    deadline = time.monotonic() + CONNECT_S
    while (found := bool(publisher.matching_status.matching)) != wanted and time.monotonic() < deadline:
        time.sleep(POLL_S)
    return found == wanted


def _reaches_relay(session: zenoh.Session, key: str) -> bool:
    """Wait until this session knows that the relay subscribes to `key`; return whether it does.

    The hub admits participants before the relay subscribes, and drops their messages until then.

    A router and the hub set up their routes to each other one after the other, and each drops messages without a
    route. The relay's subscription arrives here over one direction. The robot's liveliness token, which is declared
    afterwards, goes back over the other: when the relay sees it, both routes exist.
    """
    with _publisher(session, key) as publisher:
        return _matches(publisher, wanted=True)


def open_connected(config: zenoh.Config, credential: Credential) -> zenoh.Session:
    """Open a session with `credential`; ConnectionError if the hub does not answer, or refuses the credential."""
    hub = credential.hub
    if credential.certificate is not None:
        # Over TLS, zenoh takes the text before the port for the server's name, which must not have brackets.
        hub = hub.replace("[", "").replace("]", "")
    insert(config, "connect/endpoints", [hub])
    insert(config, "connect/timeout_ms", int(1000 * CONNECT_S))
    insert(config, "connect/exit_on_failure", True)
    insert(
        config,
        "connect/retry",
        {"period_init_ms": 20, "period_max_ms": 200, "period_increase_factor": 1.5},
    )
    if credential.certificate is not None:
        use_tls(config, credential.certificate, "connect")
    else:
        insert(config, "transport/auth/usrpwd/user", credential.name)
        insert(config, "transport/auth/usrpwd/password", credential.password)
    try:
        return zenoh.open(config)
    except zenoh.ZError:
        cause = certificate_fault(credential) or _refusal(credential)
        raise ConnectionError(
            f"{credential.name}: cannot join at {credential.hub} within {CONNECT_S:g} s: {cause}"
        ) from None


def _refusal(credential: Credential) -> str:
    """Return why the hub did not accept a credential: nothing listens at its address, or it has refused."""
    host, _, port = credential.hub.partition("/")[2].rpartition(":")
    host = host.strip("[]")
    certificate = credential.certificate
    try:
        with socket.create_connection((host, int(port)), PROBE_S) as link:
            cause = "" if certificate is None else _cause_by_tls(link, host, certificate)
    except OSError as error:
        reason = str(error.strerror or error)
        return f"no hub answers ({reason}); does it run, and does its firewall admit this port?"
    if certificate is None:
        return f"a program answers, but the password is not valid for its run ({credential.run})"
    return f"a program answers, but the certificate is not valid for its run ({credential.run}): {cause}"


def _cause_by_tls(link: socket.socket, host: str, certificate: Certificate) -> str:
    """Return why hub and client refuse each other, by a TLS handshake in which the client shows no certificate."""
    import ssl  # noqa: PLC0415  needed only for this message

    context = ssl.create_default_context(cadata=certificate.authority)
    context.verify_flags &= ~ssl.VERIFY_X509_STRICT  # the default since Python 3.13; zenoh demands less
    try:
        context.wrap_socket(link, server_hostname=host).close()
    except ssl.SSLCertVerificationError as error:
        if error.verify_code in OTHER_HOST:
            return f"the certificate of the hub names no {host}"
        return f"that of the hub is not valid ({error.verify_message}); were both made by the same call of murmur keys?"
    except OSError as error:
        return f"the program does not use TLS ({error})"
    return "the hub refuses it; were both made by the same call of murmur keys, and is the clock of its host right?"


def certificate_fault(credential: Credential) -> str:
    """Return why a hub would refuse the certificate of a credential: its name, or its dates by the clock of this host.

    Empty if there is no such reason, or no certificate.
    """
    if credential.certificate is None:
        return ""
    from cryptography import x509  # noqa: PLC0415  needed only for credentials of users, and for this message

    try:
        _, read = (
            x509.load_pem_x509_certificate(pem.encode())
            for pem in (credential.certificate.authority, credential.certificate.certificate)
        )
    except ValueError:
        return "its certificate, or that of the authority, is damaged"
    owner = read.subject.rfc4514_string().removeprefix("CN=")
    if owner != credential.name:
        return f"its certificate is that of {owner}"
    now, first, last = datetime.now(UTC), read.not_valid_before_utc, read.not_valid_after_utc
    if first <= now < last:
        return ""
    return (
        f"its certificate is valid from {first:%Y-%m-%d} to {last:%Y-%m-%d}, and the clock of this host shows "
        f"{now:%Y-%m-%d}; set the clock, or make new certificates"
    )


def plain_config(mode: str) -> zenoh.Config:
    """Return a configuration without discovery: the session contacts only the addresses that it is given.

    Shared memory is off: with it, messages larger than 3 kB would bypass the network and its byte counts, and a
    killed process would leave its segment behind. Priorities are off: with them, the notice that a participant left
    would overtake its last messages.
    """
    config = zenoh.Config()
    insert(config, "mode", mode)
    insert(config, "transport/shared_memory/enabled", False)
    for key in ("scouting/multicast/enabled", "scouting/gossip/enabled"):
        insert(config, key, False)
    insert(config, "scouting/delay", 0)
    insert(config, "transport/unicast/qos/enabled", False)
    return config


def use_tls(config: zenoh.Config, certificate: Certificate, side: str) -> None:
    """Configure mutual TLS for the side that is to ``listen`` or to ``connect``.

    TLS keeps the bytes that a full socket does not take until more is sent. Keep-alive messages ten times a second
    flush them; otherwise the end of a long message could wait for seconds. On a slow link, a sender waits as long as
    the lease for its turn before it gives up the connection.
    """
    insert(config, "transport/link/tls", mutual_tls(certificate, side))
    insert(config, "transport/link/tx/batch_size", BATCH_BYTES)
    insert(config, "transport/link/tx/queue/congestion_control/block/wait_before_close", 1000 * LEASE_MS)
    insert(config, "transport/link/tx/lease", LEASE_MS)
    insert(config, "transport/link/tx/keep_alive", LEASE_MS // KEEP_ALIVE_MS)


def receive_apart() -> None:
    """Receive on a separate executor, in a process that routes over links between hosts.

    Routing to a slow link blocks its executor, which must not be the one that receives the link's acknowledgments.
    Call this before the first session opens.
    """
    os.environ["ZENOH_RUNTIME"] = "(acc: (handover: app), net: (handover: app))"


def send_along() -> None:
    """Send and receive on one executor, in a process that is only a client on this host.

    It routes nothing, so only its own `put` waits for a link. Call this before the first session opens.
    """
    os.environ["ZENOH_RUNTIME"] = (
        "(rx: (handover: app), acc: (handover: app), tx: (handover: app), net: (handover: app))"
    )


def mutual_tls(certificate: Certificate, side: str) -> dict[str, object]:
    """Return zenoh's settings of mutual TLS for one side, with the certificates as text instead of files."""
    texts = {
        "root_ca_certificate": certificate.authority,
        f"{side}_certificate": certificate.certificate,
        f"{side}_private_key": certificate.key,
    }
    coded = {f"{key}_base64": base64.b64encode(pem.encode()).decode() for key, pem in texts.items()}
    return {"enable_mtls": True, **coded}


def insert(config: zenoh.Config, key: str, value: object) -> None:
    """Set one key of a zenoh configuration."""
    config.insert_json5(key, json.dumps(value))
