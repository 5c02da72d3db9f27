"""Digest of all that determines a kernel's machine code, so that no kernel is called that is out of date.

It covers the bytecode, constants, and types of a kernel, the values of the global names that it uses, and the kernels
that it calls. Line numbers and file names do not count. What all kernels depend on is in the name of the library
(`protocol.native.library`).
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

MODULES = ("math", "numpy")
"""Modules whose members may be used by name; their versions are in the name of the library."""


def digest_of(function: FunctionType, signature: str, called: Mapping[str, str]) -> str:
    """Return the digest of a kernel in hexadecimal digits.

    `signature` is that of the kernel in numba's notation. `called` has the digests of the kernels that it calls, by the
    names that it has for them. The digest is empty if the kernel uses an object, or calls a kernel, that has none.
    """
    if "" in called.values() or function.__closure__ or function.__defaults__:
        return ""
    try:
        used = [
            f"{name}={called.get(name) or _text(function.__globals__[name])}"
            for name in _names(function.__code__)
            if name in function.__globals__
        ]
        text = "\n".join([signature, _code(function.__code__), *used])
    except TypeError:
        return ""
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _names(code: CodeType) -> list[str]:
    """Return the global names and attributes that `code` uses, with those of functions inside it."""
    inner = [each for each in code.co_consts if isinstance(each, CodeType)]
    return sorted(set(code.co_names).union(*map(_names, inner)))


def _code(code: CodeType) -> str:
    """Return the bytecode with its constants and names."""
    names = (code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars, code.co_argcount)
    constants = ",".join(
        _code(each) if isinstance(each, CodeType) else _text(each) for each in code.co_consts
    )
    return f"{code.co_code.hex()} {code.co_exceptiontable.hex()} {names} {constants}"


def _text(value: Any) -> str:
    """Return a text that differs for different values; TypeError if the value has none."""
    match value:
        case None | bool() | int() | float() | str() if type(value) in (type(None), bool, int, float, str):
            return repr(value)
        case tuple() if type(value) is tuple:
            return f"({','.join(map(_text, value))})"
        case slice():  # a constant since Python 3.14
            return f"slice{_text((value.start, value.stop, value.step))}"
        case np.ndarray():
            return f"{value.dtype.str}{value.shape}{hashlib.sha256(value.tobytes()).hexdigest()}"
        case np.generic():
            return f"{value.dtype.str}{value!r}"
        case BuiltinFunctionType() | type():
            return f"{value.__module__}.{value.__qualname__}"
        case ModuleType() if value.__name__ in MODULES:
            return value.__name__
    raise TypeError(f"{type(value).__name__} has no digest")
