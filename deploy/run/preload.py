"""What the fork server has in memory before robots are forked from it: the processes' code, and all kernels loaded.

Processes share it as long as none of them writes on it. So it is little: of kernels the code alone. And what there is
by then is kept from the garbage collector, which would write on every object that it looks at. What was freed by then
is not used any more.

`python -m deploy.run.preload` compiles the kernels of a fresh installation (`make setup` does).
"""

from __future__ import annotations

import gc

import scipy.ndimage
import scipy.optimize

from deploy.run import processes
from deploy.run.garbage import look_seldom
from deploy.run.heap import fill_holes
from protocol import kernels

__all__ = ["processes", "scipy"]

kernels.load_code()
gc.collect()
look_seldom()
fill_holes()
