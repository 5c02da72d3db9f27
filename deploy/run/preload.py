"""Modules and kernels that the fork server loads before it forks the processes of a run.

The processes share this memory as long as none of them writes to it. Frozen objects are exempt from garbage
collection, which would write to each of them.

`python -m deploy.run.preload` compiles the kernels of a fresh installation; `make setup` runs it.
"""

from __future__ import annotations

import gc

import scipy.ndimage
import scipy.optimize

from deploy.run import processes
from protocol import kernels

__all__ = ["processes", "scipy"]

kernels.load_all()
gc.collect()
gc.freeze()
