"""Modules and kernels that the fork server loads before it forks the processes of a run.

The processes share this memory as long as none of them writes to it. Frozen objects are exempt from garbage
collection, which would write to each of them.

The import compiles kernels that are neither in the library nor in numba's cache: those of a fresh installation
(`murmur setup`).
"""

from __future__ import annotations

import gc

import scipy.ndimage

from deploy.run import processes
from protocol import kernels
from worldsim import people, world

__all__ = ["people", "processes", "scipy", "world"]

kernels.load_all()
gc.collect()
gc.freeze()
