"""Holes of the heap are filled, in a process of its own, whose heap nobody else changes meanwhile."""

import ctypes
import subprocess
import sys

import pytest

HOLES = """
import ctypes
import sys
from deploy.run.heap import fill_holes

libc = ctypes.CDLL(None)
libc.malloc.restype, libc.malloc.argtypes = ctypes.c_void_p, [ctypes.c_size_t]
libc.free.restype, libc.free.argtypes = None, [ctypes.c_void_p]
fill_holes()
size, count = map(int, sys.argv[1:])
pieces = [libc.malloc(size) for _ in range(count)]
for piece in pieces[::2]:
    libc.free(piece)
print(fill_holes(), fill_holes(), sorted(set(pieces[::2]) & {libc.malloc(size) for _ in range(count)}))
"""


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "mallinfo2"), reason="the C library is not glibc")
@pytest.mark.parametrize(("size", "count"), [(5000, 200), (1100, 150_000)])
def test_what_was_freed_inside_the_heap_is_not_used_again(size: int, count: int) -> None:
    command = [sys.executable, "-c", HOLES, str(size), str(count)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)

    filled, again, reused = done.stdout.split(maxsplit=2)
    assert 0.9 < int(filled) / (count // 2 * size) < 1.1
    assert int(again) == 0
    assert reused.strip() == "[]"
