"""Find and load the library of kernels.

Its name has a digest of all that machine code depends on besides the kernels themselves: processor, system, versions
of Python and of libraries, numba's settings, and the code that builds the library. So a library of another processor
or version is never loaded.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable
from functools import cache
from importlib.machinery import ExtensionFileLoader
from importlib.metadata import PackageNotFoundError, version
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any, cast

from protocol.numba_import import user_cache

MODULE = "murmur_kernels"
"""Name of the extension module."""

PACKAGES = ("numba", "llvmlite", "numpy")

_HERE = Path(__file__).parent
_BUILDERS = ("machine_code.py", "wrappers.py", "runtime.c")
_PROCESSOR = (
    "vendor_id", "cpu family", "model", "model name", "stepping", "flags",
    "CPU implementer", "CPU architecture", "CPU variant", "CPU part", "Features",
)  # fmt: skip
"""Keys of ``/proc/cpuinfo`` that tell processors apart."""


def find(digest: str) -> Callable[..., Any] | None:
    """Return the compiled kernel with this digest; None if the library or the kernel is missing."""
    return cast("Callable[..., Any] | None", getattr(_library(), digest, None)) if digest else None


def library_file() -> Path | None:
    """Return the file of the library that this process uses; None if there is no valid one."""
    module = _library()
    return Path(str(module.__file__)) if module else None


def folder() -> Path | None:
    """Return the directory of the library that this process uses; None if there is no valid one."""
    file = library_file()
    return file.parent if file else None


def forget() -> None:
    """Look for the library again at the next call, since it was built."""
    _library.cache_clear()


def folders() -> list[Path]:
    """Return the directories in which the library may be, best first: those of numba's cache."""
    tree = f"murmur_{hashlib.sha256(str(_HERE).encode()).hexdigest()[:16]}"
    if place := os.environ.get("NUMBA_CACHE_DIR"):
        return [Path(place) / tree]
    places = [_HERE.parent / "__pycache__"]
    return [*places, Path(user) / "numba" / tree] if (user := user_cache()) else places


@cache
def file_name() -> str:
    """Return the name of a library that is valid here; empty if a package is missing."""
    try:
        versions = [version(package) for package in PACKAGES]
    except PackageNotFoundError:
        return ""
    settings = [f"{key}={value}" for key, value in sorted(os.environ.items()) if _changes_code(key)]
    parts = [sys.version, sys.platform, *versions, *settings, _processor()]
    digest = hashlib.sha256("\n".join(parts).encode())
    for builder in _BUILDERS:
        digest.update((_HERE / builder).read_bytes())
    return f"{MODULE}-{digest.hexdigest()[:16]}.so"


def load(file: Path) -> ModuleType:
    """Load a library; ImportError if it does not fit this process."""
    spec = spec_from_file_location(MODULE, file, loader=ExtensionFileLoader(MODULE, str(file)))
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@cache
def _library() -> ModuleType | None:
    """Load the first valid library."""
    for folder in folders():
        file = folder / file_name()
        if file_name() and file.is_file():
            try:
                return load(file)
            except ImportError:  # damaged: the next one, or numba
                continue
    return None


def _changes_code(key: str) -> bool:
    """Whether an environment variable may change what numba compiles."""
    return key.startswith("NUMBA_") and key not in ("NUMBA_CACHE_DIR", "NUMBA_NUM_THREADS")


def _processor() -> str:
    """Return a text that differs between processors; or else between hosts, if the system does not tell."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:  # noqa: PTH123  of the first processor only
            lines = [line for line in file.read(16384).partition("\n\n")[0].splitlines() if ":" in line]
    except OSError:
        return " ".join(os.uname())
    return "\n".join(line for line in lines if line.partition(":")[0].strip() in _PROCESSOR)
