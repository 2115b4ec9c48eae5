"""The compiled rule of progress along a stroke.

The arrays are contiguous float64; all lengths are metres. `smp_gym.tasks.draw_s.rules` says what
the rule means.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from smp_gym.arrays import FloatArray
from smp_gym.compiling import kernel

__all__ = ["passed_in_order"]


@kernel
def passed_in_order(
    traces: FloatArray,
    checkpoints: FloatArray,
    demanded: FloatArray,
    tolerance: float,
    subdivision: int,
) -> NDArray[np.int64]:
    """Return the progress of traces along their strokes.

    Args:
        traces: (B, N, 3).
        checkpoints: (B, K, 3).
        demanded: (B, K), above 0.5 where a checkpoint counts.
        tolerance: how near to a checkpoint a trace must come.
        subdivision: points into which the line between two neighbouring points is cut.

    Returns:
        (B,) index of the first demanded checkpoint that was not passed, K if all were.
    """
    batch, points, _ = traces.shape
    count = checkpoints.shape[1]
    places = (points - 1) * subdivision + 1
    reached = np.full(batch, count)
    for b in range(batch):
        place = 0
        for k in range(count):
            if demanded[b, k] <= 0.5:
                continue
            while place < places:
                n = place // subdivision
                share = (place - n * subdivision) / subdivision
                square = 0.0
                for axis in range(3):
                    at = traces[b, n, axis]
                    if share > 0.0:
                        at += share * (traces[b, n + 1, axis] - at)
                    square += (at - checkpoints[b, k, axis]) ** 2
                if square <= tolerance * tolerance:
                    break
                place += 1
            if place == places:
                reached[b] = k
                break
    return reached
