"""Certificates with which participants could not join are found when the relay starts."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from netshaper import certificates
from netshaper.certificate_check import check
from protocol import keys as names


def made(folder: Path, *, days: int = 1) -> Path:
    certificates.write(certificates.make(2, ["127.0.0.1", "hub.local", "::1"], days), folder)
    return folder


def checked(folder: Path, address: str = "127.0.0.1") -> None:
    check(folder, certificates.read(folder, 2), address)


def test_fresh_certificates_are_valid_for_each_address_of_the_hub(tmp_path: Path) -> None:
    folder = made(tmp_path / "keys")
    for address in ("127.0.0.1", "hub.local", "[::1]"):
        checked(folder, address)
    with pytest.raises(
        ValueError, match=r"relay\.pem: is valid for a hub at 127.0.0.1, hub.local, ::1, not at 10.1"
    ):
        checked(folder, "10.1.1.1")


def test_expired_certificates_are_named_with_their_date(tmp_path: Path) -> None:
    folder = made(tmp_path / "keys", days=0)
    with pytest.raises(ValueError, match=r"\.pem: expired on \d{4}-\d\d-\d\d; create all files anew"):
        checked(folder)


def test_routers_are_checked_too(tmp_path: Path) -> None:
    rack = f"{names.ROUTER}rack"
    certificates.write(certificates.make(2, ["127.0.0.1"], 1, {rack: ["r0"]}), tmp_path)
    checked(tmp_path)
    (tmp_path / f"{rack}.key").write_text((tmp_path / "r1.key").read_text())
    with pytest.raises(ValueError, match=r"\.key: is not the key of"):
        checked(tmp_path)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (
            lambda own, other: shutil.copy(other / "r0.pem", own / "r0.pem"),
            r"r0\.pem: is not of the authority in",
        ),
        (
            lambda own, other: shutil.copy(other / "authority.pem", own),
            r"relay\.pem: is not of the authority in",
        ),
        (lambda own, _: shutil.copy(own / "r1.pem", own / "r0.pem"), r"r0\.pem: is the certificate of r1"),
        (lambda own, _: shutil.copy(own / "r1.key", own / "r0.key"), r"r0\.key: is not the key of r0\.pem"),
        (lambda own, _: halve(own / "r0.pem"), r"r0\.pem: is damaged"),
        (lambda own, _: halve(own / "r0.key"), r"r0\.key: is damaged"),
        (lambda own, _: halve(own / "authority.pem"), r"authority\.pem: is damaged"),
    ],
)
def test_wrong_files_are_named(tmp_path: Path, damage: Callable[[Path, Path], object], message: str) -> None:
    own, other = made(tmp_path / "own"), made(tmp_path / "other")
    damage(own, other)
    with pytest.raises(ValueError, match=message):
        checked(own)


def halve(path: Path) -> None:
    path.write_text(path.read_text()[: path.stat().st_size // 2])
