"""Names for arrays by the type of their entries."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["AnyFloatArray", "BoolArray", "Float32Array", "FloatArray", "IntArray"]

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

AnyFloatArray = NDArray[np.floating[Any]]
"""Of any precision: goals are float32 in observations and float64 in the rules."""
