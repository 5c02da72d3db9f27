"""Kernels for tests of the library, and calls of them that run in processes of their own."""

from __future__ import annotations

import importlib
import weakref
from pathlib import Path
from typing import Any

import numpy as np

PARTS = """
import numpy as np
from protocol.arrays import Bools, FloatRows, Floats, Int64s, Int32Rows, ReadOnlyUint8s, Uint8, Uint8s
from protocol.kernels import kernel

SHIFT = 10
TABLE = np.arange(5) ** 2


@kernel
def shifted(number: int) -> int:
    return number + SHIFT


@kernel
def twice_shifted(number: int) -> int:
    return shifted(number) + shifted(number)


@kernel
def less(one: float, other: float) -> bool:
    return one < other


@kernel
def negated(value: bool) -> bool:
    return not value


@kernel
def byte(value: Uint8) -> Uint8:
    return value


@kernel
def ratio(one: float, other: float) -> float:
    return one / other


@kernel
def total(numbers: Int64s, factor: float) -> float:
    return numbers.sum() * factor


@kernel
def fill(rows: FloatRows, value: float) -> None:
    rows[:] = value


@kernel
def count(data: ReadOnlyUint8s) -> int:
    return np.count_nonzero(data)


@kernel
def member(pair: tuple[int, tuple[Floats, bool]], place: int) -> tuple[float, tuple[int, bool]]:
    return pair[1][0][place] + TABLE[2], (pair[0], pair[1][1])


@kernel
def views(numbers: Int64s) -> tuple[Int64s, Int64s, Int64s]:
    return numbers, numbers[1:3], numbers * 2


@kernel
def same(numbers: Int64s) -> Int64s:
    return numbers


@kernel
def above(numbers: Floats, bound: float) -> Bools:
    return numbers > bound


@kernel
def rows_of(numbers: Int64s, width: int) -> Int32Rows:
    return numbers.astype(np.int32).reshape(-1, width)


@kernel
def sorted_by_list(numbers: Int64s) -> Int64s:
    found = [numbers[0]]
    for each in numbers[1:]:
        found.append(each)
    found.sort()
    return np.array(found)


@kernel
def check(number: int) -> int:
    if number < 0:
        raise ValueError("negative")
    if number > 9:
        raise IndexError("above nine", number)
    return number
"""

SMALL = """
from protocol.kernels import kernel


@kernel
def shifted(number: int) -> int:
    return number + 10
"""

PLUG_IN = """
from parts import shifted
from protocol.kernels import kernel


@kernel
def thrice_shifted(number: int) -> int:
    return 3 * shifted(number)


@kernel
def never_called(number: int) -> int:
    return 5 * shifted(number)
"""


def print_results() -> None:
    """Print results of all types."""
    parts = importlib.import_module("parts")
    numbers = np.array([5, -3, 8, 1], np.int64)
    rows = np.zeros((2, 3))
    show(
        parts.twice_shifted(4),
        parts.less(1.0, 2.0),
        parts.ratio(1.0, 3.0),
        parts.ratio(1.0, 0.0),
        parts.byte(7),
    )
    show(
        parts.fill(rows, 2.5), rows, parts.total(numbers, 0.1), parts.count(np.frombuffer(b"a\0b", np.uint8))
    )
    show(
        *parts.views(numbers),
        parts.above(rows[0], 2.0),
        parts.rows_of(numbers, 2),
        parts.sorted_by_list(numbers),
    )
    show(parts.member((3, (np.array([0.5, 0.25]), True)), 1))
    show(
        parts.same(numbers) is numbers,
        parts.views(numbers)[0] is numbers,
        parts.views(numbers)[1].base is None,
    )
    show(parts.same(np.zeros(0, np.int64)), parts.rows_of(np.zeros(0, np.int64), 3))


def print_conversions() -> None:
    """Print what becomes of numbers of other types."""
    parts = importlib.import_module("parts")
    for number in (
        True,
        3,
        2.75,
        -2.75,
        np.int8(-4),
        np.uint16(5),
        np.float32(0.1),
        np.float64(1e3),
        np.True_,
    ):
        show(parts.shifted(number), parts.less(number, 3), parts.negated(number), parts.ratio(number, 7))
    show(
        parts.negated(256),
        parts.negated(0.5),
        parts.byte(255),
        parts.byte(np.int64(44)),
        parts.ratio(2**70, 1),
    )
    show(parts.member((np.uint8(2), (np.zeros(1), 1)), 0))


def print_errors() -> None:
    """Print the types of the errors that arguments of wrong types give."""
    parts = importlib.import_module("parts")
    numbers = np.arange(6)
    frozen = numbers.copy()
    frozen.flags.writeable = False
    unaligned = np.zeros(17, np.uint8)[1:].view(np.int64)
    wrong: list[Any] = [
        numbers.astype(np.int32), numbers.astype(np.uint64), numbers.astype(float), numbers.astype(">i8"),
        numbers.view("m8[ns]"), numbers.reshape(2, 3), numbers[::2], frozen, unaligned, [1, 2], None, 3,
        np.array(5),
    ]  # fmt: skip
    for each in wrong:
        attempt(parts.total, each, 1.0)
        attempt(parts.views, each)
    for each in ("1", None, 1j, [1], numbers, np.array(1), 2**64):
        attempt(parts.shifted, each)
    for each in (
        (1, 2),
        (1, [numbers * 1.0, True]),
        (1, (numbers, True)),
        (1, (numbers * 1.0, True), 2),
        [1, (2, 3)],
    ):
        attempt(parts.member, each, 0)
    attempt(parts.shifted)
    attempt(parts.shifted, 1, 2)


def print_exceptions() -> None:
    """Print exceptions that kernels raise."""
    parts = importlib.import_module("parts")
    for number in (5, -1):
        attempt(parts.check, number, with_text=True)
    attempt(parts.rows_of, np.arange(5), 2, with_text=True)


def print_references() -> None:
    """Check that arrays live as long as what kernels returned of them, and no longer."""
    parts = importlib.import_module("parts")
    for _ in range(1000):
        numbers = np.arange(50_000)
        watched = weakref.ref(numbers)
        same, view, new = parts.views(numbers)
        assert same is numbers
        del numbers, same
        assert watched() is not None
        assert view.tolist() == [1, 2]
        del view
        assert watched() is None
        assert new[-1] == 2 * 49_999
    size = resident()
    for _ in range(1000):
        attempt(parts.views, np.arange(50_000, dtype=np.int32), silent=True)
        parts.views(np.arange(50_000))
    assert resident() - size < 50e6
    print("all memory is released")


def resident() -> int:
    """Return the resident memory of this process in bytes."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * 4096


def show(*results: Any) -> None:
    """Print results with their types."""
    for each in results:
        if isinstance(each, np.ndarray):
            print(each.dtype, each.shape, each.tolist(), each.flags.writeable, each.flags.c_contiguous)
        else:
            print(type(each).__name__, repr(each))


def attempt(function: Any, *arguments: Any, with_text: bool = False, silent: bool = False) -> None:
    """Call a kernel; print its result, or its error."""
    try:
        result = function(*arguments)
    except (TypeError, ValueError, OverflowError, IndexError, NotImplementedError) as error:
        if not silent:
            print(type(error).__name__, error if with_text else "")
    else:
        show(result)
