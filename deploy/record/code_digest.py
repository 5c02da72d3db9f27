"""The digest of the code that determines the behavior of a robot: all robots of a team need equal ones."""

from __future__ import annotations

import hashlib
import importlib.util
from collections.abc import Sequence
from pathlib import Path

PACKAGES = ("agent", "protocol")
"""Packages that determine the behavior of a robot."""


def code_digest(starters: Sequence[str] = ()) -> str:
    """Return the digest of these packages and of the modules `starters`: robots with equal ones behave equally."""
    files = [(name, _file_of(name)) for name in starters]
    for package in PACKAGES:
        root = _file_of(package).parent
        files += [(f"{package}/{path.relative_to(root).as_posix()}", path) for path in root.rglob("*.py")]
    digest = hashlib.sha256()
    for name, path in sorted(files):
        digest.update(f"{name}\0".encode() + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:16]


def _file_of(module: str) -> Path:
    """Return the file of a module without importing it."""
    spec = importlib.util.find_spec(module)
    assert spec is not None and spec.origin is not None
    return Path(spec.origin)
