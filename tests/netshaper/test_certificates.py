"""Mutual TLS: which clients the hub accepts; its rules are the same as with passwords."""

from __future__ import annotations

import datetime
import re
import socket
import stat
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import pytest
import zenoh
from cryptography import x509

from netshaper import access, certificates
from netshaper.hub import open_hub
from protocol import keys as names
from protocol.bus import Bus, Message
from protocol.keys import Keys
from protocol.zenoh_bus import Certificate, Credential, insert, join, mutual_tls, plain_config

pytestmark = pytest.mark.slow

KEYS = Keys("certified")
RELAY, WORLD, RECORDER = names.RELAY, names.WORLD, names.RECORDER
SOON_S = 30.0
"""Longest wait for a message that must arrive. On a busy machine, a connection takes seconds."""
BLOCK = zenoh.CongestionControl.BLOCK
FORGED = [
    KEYS.radio_tx("r0"),
    KEYS.control_tx("r0"),
    KEYS.control_tx(RECORDER),
    KEYS.radio_rx("r0", "r1"),
    KEYS.control("r0", RELAY),
    KEYS.body("r0", WORLD),
    KEYS.body(WORLD, "r0"),
    KEYS.alive("r0"),
    KEYS.presence("r0"),
    f"murmur/{KEYS.run}/**",
    "**",
]


class Certified:
    """A run of two robots over mutual TLS."""

    def __init__(self, stack: ExitStack, address: str) -> None:
        with closing(socket.socket(socket.AF_INET6 if ":" in address else socket.AF_INET)) as probe:
            probe.bind((address.strip("[]"), 0))
            self.endpoint = f"tls/{address}:{probe.getsockname()[1]}"
        self.certificates = certificates.make(2, [address])
        self.credentials = certificates.credentials(KEYS.run, self.endpoint, self.certificates)
        hub = open_hub(KEYS.run, self.endpoint, self.credentials, self.certificates[RELAY])
        self.ends: dict[str, Bus] = {RELAY: hub}
        stack.callback(hub.close)
        for name in (WORLD, RECORDER, "r0"):
            self.ends[name] = join(self.credentials[name])
            stack.callback(self.ends[name].close)
            assert self.receive(RELAY) == Message(KEYS.presence(name), b"1")

    def receive(self, name: str) -> Message:
        message = self.ends[name].receive(SOON_S)
        assert message is not None, f"{name} received nothing"
        return message

    def session(self, certificate: Certificate | None, authority: str = "") -> zenoh.Session:
        config = plain_config("client")
        insert(config, "connect/endpoints", [self.endpoint])
        insert(config, "connect/timeout_ms", 400 if certificate is None or authority else 5000)
        insert(config, "connect/exit_on_failure", True)
        if certificate is not None:
            insert(config, "transport/link/tls", mutual_tls(certificate, "connect"))
        else:
            trusted = mutual_tls(self.certificates["r1"], "connect")["root_ca_certificate_base64"]
            insert(config, "transport/link/tls", {"root_ca_certificate_base64": trusted})
        return zenoh.open(config)


@pytest.fixture
def certified() -> Iterator[Certified]:
    with ExitStack() as stack:
        yield Certified(stack, "127.0.0.1")


@pytest.mark.parametrize("address", ["127.0.0.1", "[::1]"])
def test_participants_with_certificates_have_their_rights(address: str) -> None:
    with ExitStack() as stack:
        check_rights(Certified(stack, address))


def check_rights(certified: Certified) -> None:
    for sender, key, receiver in [
        ("r0", KEYS.radio_tx("r0"), RELAY),
        ("r0", KEYS.body(WORLD, "r0"), WORLD),
        ("r0", KEYS.control(RECORDER, "r0"), RECORDER),
        (WORLD, KEYS.body("r0", WORLD), "r0"),
        (RELAY, KEYS.radio_rx("r0", "r1"), "r0"),
    ]:
        certified.ends[sender].put(key, b"sent")
        assert certified.receive(receiver) == Message(key, b"sent")


def test_a_rogue_with_a_robots_certificate_is_held_to_that_robots_rules(certified: Certified) -> None:
    rogue = certified.session(certified.certificates["r1"])
    try:
        recording_bus = rogue.declare_subscriber("**", zenoh.handlers.FifoChannel(1000))
        token = rogue.liveliness().declare_token(KEYS.alive("r0") + "x")
        for key in FORGED:
            rogue.put(key, b"forged", congestion_control=BLOCK, allowed_destination=zenoh.Locality.REMOTE)
        own = KEYS.radio_tx("r1")
        publisher = rogue.declare_publisher(
            own, congestion_control=BLOCK, allowed_destination=zenoh.Locality.REMOTE
        )
        publisher.put(b"mine")
        assert certified.receive(RELAY) == Message(own, b"mine")
        certified.ends[RELAY].put(KEYS.control("r0", RELAY), b"secret")
        certified.ends[WORLD].put(KEYS.body("r0", WORLD), b"secret")
        assert {certified.receive("r0").payload for _ in range(2)} == {b"secret"}
        certified.ends["r0"].put(KEYS.control_tx("r0"), b"last")
        assert certified.receive(RELAY) == Message(KEYS.control_tx("r0"), b"last")
        for name, end in certified.ends.items():
            assert end.receive(0) is None, name
        assert recording_bus.handler.try_recv() is None
        token.undeclare()
    finally:
        rogue.close()  # type: ignore[no-untyped-call]


def test_the_hub_refuses_clients_without_a_certificate_or_with_one_of_another_run(
    certified: Certified,
) -> None:
    with pytest.raises(zenoh.ZError):
        certified.session(None)
    other = certificates.make(2, ["127.0.0.1"])["r1"]
    mixed = Certificate(certified.certificates["r1"].authority, other.certificate, other.key)
    with pytest.raises(zenoh.ZError):
        certified.session(mixed, authority="not of this run")


def test_a_refused_client_gets_the_reason(certified: Certified, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("protocol.zenoh_bus.CONNECT_S", 0.4)

    def refused(certificate: Certificate, hub: str = certified.endpoint) -> str:
        with pytest.raises(ConnectionError) as caught:
            join(Credential(KEYS.run, "r1", hub, certificate=certificate))
        return str(caught.value)

    right, stranger = certified.certificates["r1"], certificates.make(2, ["127.0.0.1"])["r1"]
    not_valid = "r1: cannot join at tls/127.* the certificate is not valid for its run .*"
    assert re.match(
        f"{not_valid} that of the hub is not valid \\(certificate signature failure", refused(stranger)
    )
    mixed = Certificate(right.authority, stranger.certificate, stranger.key)
    assert re.match(f"{not_valid} the hub refuses it", refused(mixed))
    elsewhere = certified.endpoint.replace("127.0.0.1", "localhost")
    assert "the certificate of the hub names no localhost" in refused(right, elsewhere)
    expired = certificates.make(2, ["127.0.0.1"], days=0)["r1"]
    assert re.search(
        r"is valid from 20\S+ to 20\S+, and the clock of this host shows 20\S+; set the clock",
        refused(expired),
    )
    other = certified.certificates["r0"]
    assert "its certificate is that of r0" in refused(other, "tls/127.0.0.1:1")
    damaged = Certificate("", right.certificate, right.key)
    assert "its certificate, or that of the authority, is damaged" in refused(damaged)
    with closing(socket.create_server(("127.0.0.1", 0))) as silent:
        monkeypatch.setattr("protocol.zenoh_bus.PROBE_S", 0.2)
        hub = f"tls/127.0.0.1:{silent.getsockname()[1]}"
        assert "the program does not use TLS" in refused(right, hub)


@pytest.mark.parametrize(
    ("impostor", "address", "at"),
    [
        ("r0", "127.0.0.1", "127.0.0.1"),
        (RELAY, "192.0.2.1", "127.0.0.1"),
        (RELAY, "::2", "[::1]"),
        ("router@a", "127.0.0.1", "127.0.0.1"),
    ],
)
def test_a_robot_rejects_another_robot_as_hub(
    impostor: str, address: str, at: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Certificates that are not valid for this hub: those of a robot or router, or of a hub at another address."""
    monkeypatch.setattr("protocol.zenoh_bus.CONNECT_S", 0.4)
    made = certificates.make(2, [address], routers={"router@a": ["r0"]} if impostor == "router@a" else None)
    with closing(socket.socket(socket.AF_INET6 if ":" in at else socket.AF_INET)) as probe:
        probe.bind((at.strip("[]"), 0))
        endpoint = f"tls/{at}:{probe.getsockname()[1]}"
    credentials = certificates.credentials(KEYS.run, endpoint, made)
    with (
        closing(open_hub(KEYS.run, endpoint, credentials, made[impostor])),
        pytest.raises(ConnectionError, match="cannot join"),
    ):
        join(credentials["r1"])


def test_names_usages_and_dates_are_those_of_the_participants() -> None:
    made = certificates.make(2, ["hub.example", "10.0.0.1", "[fd00::1]"], days=3)
    assert list(made) == [RELAY, *access.participants(2)]
    for name, certificate in made.items():
        read = x509.load_pem_x509_certificate(certificate.certificate.encode())
        assert read.subject.rfc4514_string() == f"CN={name}"
        usages = read.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        assert [usage._name for usage in usages] == ["serverAuth" if name == RELAY else "clientAuth"]
        left = read.not_valid_after_utc - datetime.datetime.now(datetime.UTC)
        assert datetime.timedelta(days=2) < left <= datetime.timedelta(days=3)
    relay = x509.load_pem_x509_certificate(made[RELAY].certificate.encode())
    known_as = relay.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert known_as.get_values_for_type(x509.DNSName) == ["hub.example"]
    assert list(map(str, known_as.get_values_for_type(x509.IPAddress))) == ["10.0.0.1", "fd00::1"]


@pytest.mark.parametrize("address", ["", "10.0.0.1:7447", "a b", "-x", "http://hub"])
def test_an_invalid_address_is_refused(address: str) -> None:
    with pytest.raises(ValueError, match=r"must be a host's name or IP address"):
        certificates.make(1, [address])


def test_written_certificates_are_read_back_and_only_the_owner_can_read_keys(tmp_path: Path) -> None:
    made = certificates.make(2, ["127.0.0.1"])
    folder = tmp_path / "keys"
    written = certificates.write(made, folder)
    assert certificates.read(folder, 2) == made
    assert {path.name for path in folder.iterdir()} == {path.name for path in written}
    for path in written:
        mode = stat.S_IMODE(path.stat().st_mode)
        assert mode & 0o077 == 0 if path.suffix == ".key" else mode & 0o222 == 0o200
    assert not any("murmur" in path.name for path in written), "the authority's key is not stored"
    with pytest.raises(FileExistsError):
        certificates.write(made, folder)


def test_errors_name_missing_and_damaged_keys(tmp_path: Path) -> None:
    certificates.write(certificates.make(1, ["127.0.0.1"]), tmp_path)
    with pytest.raises(ValueError, match=r"r1\.pem: No such file or directory; murmur keys creates"):
        certificates.read(tmp_path, 2)
    (tmp_path / "r0.key").write_bytes(b"\xff")
    with pytest.raises(ValueError, match=r"r0\.key: not PEM"):
        certificates.read(tmp_path, 1)


def test_a_credential_with_a_certificate_is_read_as_it_was_written(tmp_path: Path) -> None:
    made = certificates.make(1, ["127.0.0.1"])
    credential = certificates.credentials("run", "tls/127.0.0.1:1", made)["r0"]
    credential.write(tmp_path / "r0.json")
    assert Credential.read(tmp_path / "r0.json") == credential


@pytest.mark.parametrize("damaged", ['"x"', "{}", '{"authority": "a", "certificate": "b", "key": 1}'])
def test_a_credential_whose_certificate_is_damaged_is_refused(damaged: str) -> None:
    text = f'{{"run": "a", "name": "r0", "hub": "tls/127.0.0.1:1", "certificate": {damaged}}}'
    with pytest.raises(ValueError, match=r"needs the strings .* at `\$\.certificate"):
        Credential.parse(text)
