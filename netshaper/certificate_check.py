"""Find certificates with which participants could not join, before the relay waits for them."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import serialization

from netshaper.certificates import AUTHORITY, host_name
from protocol import keys as names
from protocol.zenoh_bus import Certificate

ANEW = "create all files anew with murmur keys"


def check(folder: Path, certificates: Mapping[str, Certificate], address: str) -> None:
    """Check certificates that were read from `folder`, for a hub at a name or IP address.

    Raises ValueError that names the file if a certificate is damaged, expired, that of another participant, or of
    another authority; if its key is another one; or if that of the relay is not valid for the address.
    """
    authority = _load(folder / AUTHORITY, certificates[names.RELAY].authority)
    for name, files in certificates.items():
        path = folder / f"{name}.pem"
        certificate = _load(path, files.certificate)
        try:
            certificate.verify_directly_issued_by(authority)
        except (ValueError, TypeError, InvalidSignature):
            raise ValueError(f"keys {path}: is not of the authority in {AUTHORITY}; {ANEW}") from None
        owner = certificate.subject.rfc4514_string().removeprefix("CN=")
        if owner != name:
            raise ValueError(f"keys {path}: is the certificate of {owner or 'no participant'}; {ANEW}")
        _check_dates(path, certificate)
        _check_key(folder / f"{name}.key", files.key, certificate)
    _check_address(folder / f"{names.RELAY}.pem", certificates[names.RELAY], address)


def _load(path: Path, text: str) -> x509.Certificate:
    try:
        return x509.load_pem_x509_certificate(text.encode())
    except ValueError:
        raise ValueError(f"keys {path}: is damaged; {ANEW}") from None


def _check_dates(path: Path, certificate: x509.Certificate) -> None:
    now = datetime.datetime.now(datetime.UTC)
    first, last = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    if now >= last:
        raise ValueError(f"keys {path}: expired on {last:%Y-%m-%d}; {ANEW}, and --days for a longer time")
    if now < first:
        raise ValueError(
            f"keys {path}: is valid from {first:%Y-%m-%d} on, and the clock of this host shows {now:%Y-%m-%d}; "
            f"set the clock, or {ANEW}"
        )


def _check_key(path: Path, text: str, certificate: x509.Certificate) -> None:
    form = serialization.Encoding.DER, serialization.PublicFormat.SubjectPublicKeyInfo
    try:
        key = serialization.load_pem_private_key(text.encode(), None)
    except (ValueError, TypeError):
        raise ValueError(f"keys {path}: is damaged; {ANEW}") from None
    if key.public_key().public_bytes(*form) != certificate.public_key().public_bytes(*form):
        raise ValueError(f"keys {path}: is not the key of {path.stem}.pem; {ANEW}")


def _check_address(path: Path, relay: Certificate, address: str) -> None:
    extensions = _load(path, relay.certificate).extensions
    valid = list(extensions.get_extension_for_class(x509.SubjectAlternativeName).value)
    if host_name(address) not in valid:
        known = ", ".join(str(each.value) for each in valid)
        raise ValueError(
            f"keys {path}: is valid for a hub at {known}, not at {address}; use murmur keys --address {address}"
        )
