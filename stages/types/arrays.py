"""Names of array types by dtype, and of a pair of cameras."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Float64s = npt.NDArray[np.float64]
Float32s = npt.NDArray[np.float32]
Int64s = npt.NDArray[np.int64]
Int32s = npt.NDArray[np.int32]
Int16s = npt.NDArray[np.int16]
Uint32s = npt.NDArray[np.uint32]
Uint64s = npt.NDArray[np.uint64]
Uint16s = npt.NDArray[np.uint16]
Uint8s = npt.NDArray[np.uint8]
Bools = npt.NDArray[np.bool_]

Pair = tuple[str, str]
"""Ids of two cameras, in the order of the site file."""
