"""What the fork server has in memory before robots are forked from it: the processes' code, and all kernels loaded.

`python -m deploy.run.preload` compiles the kernels of a fresh installation (`make setup` does).
"""

from __future__ import annotations

import scipy.ndimage
import scipy.optimize

from deploy.run import processes
from protocol import kernels

__all__ = ["processes", "scipy"]

kernels.load_all()
