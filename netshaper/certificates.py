"""Certificates of a run: an authority for this run alone, and one certificate per participant.

The authority's private key is discarded after signing, so no participant can be added later. The relay's certificate is
valid only for a server and all others only for clients, so a robot cannot impersonate the hub. The common name is the
participant's name, by which the hub's access control identifies it. A router's certificate lists the robots that it
represents as alternative names; these robots have no certificates.
"""

from __future__ import annotations

import datetime
import os
import re
from collections.abc import Mapping, Sequence
from ipaddress import ip_address
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from netshaper import access
from protocol import keys as names
from protocol.files import read_file
from protocol.zenoh_bus import Certificate, Credential

AUTHORITY = "authority.pem"
_PRIVATE_KEY = serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
DAYS = 30
CLOCK_SKEW = datetime.timedelta(days=1)
"""A certificate becomes valid this long before its creation, for hosts whose clocks are behind."""


def make(
    robots: int,
    addresses: Sequence[str],
    days: int = DAYS,
    routers: Mapping[str, Sequence[str]] | None = None,
) -> dict[str, Certificate]:
    """Make certificates for the relay and all clients of a run, by name; they are valid for `days` days.

    `addresses` are names or IP addresses of the hub; participants refuse a hub whose certificate has another address.
    `routers` has the names of the robots that join through each router, by router name. Raises ValueError if an address
    is neither an IP address nor a host name.
    """
    known_as = x509.SubjectAlternativeName([host_name(address) for address in addresses])
    signer = ec.generate_private_key(ec.SECP256R1())
    now = datetime.datetime.now(datetime.UTC)

    def build(name: str, key: ec.EllipticCurvePublicKey, path_length: int | None) -> x509.CertificateBuilder:
        return (
            x509.CertificateBuilder()
            .subject_name(_common_name(name))
            .issuer_name(_common_name("murmur"))
            .public_key(key)
            .serial_number(x509.random_serial_number())
            .not_valid_before(now - CLOCK_SKEW)
            .not_valid_after(now + datetime.timedelta(days=days))
            .add_extension(x509.BasicConstraints(path_length is not None, path_length), critical=True)
        )

    authority = _pem(build("murmur", signer.public_key(), 0).sign(signer, hashes.SHA256()))
    made = {}
    routers = routers or {}
    behind = {robot for group in routers.values() for robot in group}
    at_hub = [name for name in access.participants(robots) if name not in behind]
    for name in (names.RELAY, *at_hub, *routers):
        is_hub = name == names.RELAY
        key = ec.generate_private_key(ec.SECP256R1())
        usage = ExtendedKeyUsageOID.SERVER_AUTH if is_hub else ExtendedKeyUsageOID.CLIENT_AUTH
        builder = build(name, key.public_key(), None)
        builder = builder.add_extension(x509.ExtendedKeyUsage([usage]), critical=True)
        if is_hub:
            builder = builder.add_extension(known_as, critical=False)
        if name in routers:
            robot_names = x509.SubjectAlternativeName(map(x509.DNSName, routers[name]))
            builder = builder.add_extension(robot_names, critical=False)
        private = key.private_bytes(*_PRIVATE_KEY).decode()
        made[name] = Certificate(authority, _pem(builder.sign(signer, hashes.SHA256())), private)
    return made


def credentials(run: str, hub: str, certificates: Mapping[str, Certificate]) -> dict[str, Credential]:
    """Return the credentials of all clients with a certificate, by name."""
    return {
        name: Credential(run, name, hub, certificate=certificate, robots=_robots_of(name, certificate))
        for name, certificate in certificates.items()
        if name != names.RELAY
    }


def _robots_of(name: str, certificate: Certificate) -> tuple[str, ...]:
    """Return the robots that a router represents; empty for other participants."""
    if not name.startswith(names.ROUTER):
        return ()
    read = x509.load_pem_x509_certificate(certificate.certificate.encode())
    alternative = read.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    return tuple(alternative.get_values_for_type(x509.DNSName))


def write(certificates: Mapping[str, Certificate], folder: Path) -> list[Path]:
    """Write ``authority.pem``, and ``NAME.pem`` and ``NAME.key`` of each participant; only their owner can read keys.

    Raises FileExistsError if a file with one of these names already exists.
    """
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    texts = {AUTHORITY: (0o644, next(iter(certificates.values())).authority)}
    for name, certificate in certificates.items():
        texts[f"{name}.pem"] = 0o644, certificate.certificate
        texts[f"{name}.key"] = 0o600, certificate.key
    for name, (mode, text) in texts.items():
        handle = os.open(folder / name, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
        with os.fdopen(handle, "w", encoding="ascii") as file:
            file.write(text)
    return [folder / name for name in texts]


def read(folder: Path, robots: int) -> dict[str, Certificate]:
    """Read the output of `write` for relay and all clients; robots behind a router have no files.

    Raises ValueError, with the name of the file, if a file is missing or not PEM.
    """

    def text(name: str) -> str:
        path = folder / name
        try:
            found = read_file(path).decode("ascii")
        except OSError as error:
            raise ValueError(f"keys {path}: {error.strerror}; murmur keys creates the files") from None
        except ValueError:
            found = ""
        if "-----BEGIN " not in found:
            raise ValueError(f"keys {path}: not PEM")
        return found

    def of(name: str) -> Certificate:
        return Certificate(authority, text(f"{name}.pem"), text(f"{name}.key"))

    authority = text(AUTHORITY)
    routers = {path.stem: of(path.stem) for path in sorted(folder.glob(f"{names.ROUTER}*.pem"))}
    behind = {robot for name, certificate in routers.items() for robot in _robots_of(name, certificate)}
    at_hub = [name for name in access.participants(robots) if name not in behind]
    return {name: of(name) for name in (names.RELAY, *at_hub)} | routers


def host_name(address: str) -> x509.GeneralName:
    """Return a host's name or IP address as certificates contain it; ValueError if it is neither."""
    try:
        return x509.IPAddress(ip_address(address.strip("[]")))
    except ValueError:
        pass
    if not re.fullmatch(
        r"[A-Za-z0-9]([A-Za-z0-9-]*[A-Za-z0-9])?(\.[A-Za-z0-9]([A-Za-z0-9-]*[A-Za-z0-9])?)*", address
    ):
        raise ValueError(
            f"address = {address!r}: must be a host's name or IP address, as 192.168.1.10, without a port"
        )
    return x509.DNSName(address)


def _common_name(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


def _pem(certificate: x509.Certificate) -> str:
    return certificate.public_bytes(serialization.Encoding.PEM).decode()
