"""Types of arrays: element type, number of dimensions, and memory layout.

For mypy they are plain numpy arrays. `protocol.kernels` derives the signatures of kernels from them. All arrays are
contiguous, row by row. Modules define further types with a meaning in the same way, as `protocol.grid.Grid`.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

Uint8 = Annotated[int, "uint8"]
Uint8s = Annotated[NDArray[np.uint8], "uint8[::1]"]
ReadOnlyUint8s = Annotated[NDArray[np.uint8], "Array(uint8, 1, 'C', readonly=True)"]
Uint16s = Annotated[NDArray[np.uint16], "uint16[::1]"]
Uint16Rows = Annotated[NDArray[np.uint16], "uint16[:,::1]"]
Int8s = Annotated[NDArray[np.int8], "int8[::1]"]
Int16s = Annotated[NDArray[np.int16], "int16[::1]"]
Int16Rows = Annotated[NDArray[np.int16], "int16[:,::1]"]
Int32s = Annotated[NDArray[np.int32], "int32[::1]"]
Int32Rows = Annotated[NDArray[np.int32], "int32[:,::1]"]
ReadOnlyInt32s = Annotated[NDArray[np.int32], "Array(int32, 1, 'C', readonly=True)"]
Int64s = Annotated[NDArray[np.int64], "int64[::1]"]
Int64Rows = Annotated[NDArray[np.int64], "int64[:,::1]"]
Floats = Annotated[NDArray[np.float64], "float64[::1]"]
FloatRows = Annotated[NDArray[np.float64], "float64[:,::1]"]
Bools = Annotated[NDArray[np.bool_], "boolean[::1]"]
BoolRows = Annotated[NDArray[np.bool_], "boolean[:,::1]"]

Cells = Annotated[NDArray[np.int32], "int32[:,::1]"]
"""Cells (x, y) of a grid, shape (n, 2)."""

NO_CELLS: Cells = np.empty((0, 2), np.int32)
