"""The heap that robots are forked with: its holes are filled, so that the C library does not look through them.

What was freed while modules and kernels were loaded lies about in hundreds of pieces of all sizes. With glibc each
process that is forked then walks through lists of them whenever it asks for more than a kilobyte, which took up to a
tenth of a robot's processor time. Their pages are shared with the fork server as before, since nobody writes on them.
"""

from __future__ import annotations

import ctypes

LARGEST, LEAST = 1 << 16, 1 << 10
"""Bytes of the pieces that holes are filled with; of smaller ones there are lists of equal sizes."""

SMALLER = 7 / 8


class _HeapInfo(ctypes.Structure):
    """What `mallinfo2` of glibc says of the heap, in bytes and pieces."""

    _fields_ = [
        (name, ctypes.c_size_t)
        for name in (
            "arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks", "fsmblks", "uordblks", "fordblks", "keepcost",
        )
    ]  # fmt: skip


def fill_holes() -> int:
    """Take all free pieces of `LEAST` bytes or more inside the heap for good; return how many bytes these are.

    These are 0 where the C library is not glibc 2.33 or newer.
    """
    libc = ctypes.CDLL(None)
    if not hasattr(libc, "mallinfo2"):
        return 0
    libc.mallinfo2.restype = _HeapInfo
    libc.malloc.restype, libc.malloc.argtypes = ctypes.c_void_p, [ctypes.c_size_t]
    libc.free.restype, libc.free.argtypes = None, [ctypes.c_void_p]
    libc.sbrk.restype, libc.sbrk.argtypes = ctypes.c_void_p, [ctypes.c_ssize_t]
    behind_all = libc.sbrk(0) - libc.mallinfo2().keepcost
    size, filled = LARGEST, 0
    while size >= LEAST:
        piece = libc.malloc(size)
        if piece and piece < behind_all:
            filled += size
        else:  # there was no hole: it comes from the end of the heap
            libc.free(piece)
            size = int(size * SMALLER)
    return filled
