"""Compiled rules of strokes: resampling at equal arc length, and progress along a stroke.

The arrays are contiguous float64; all lengths are metres. `smp_gym.tasks.draw_s.rules` says what
the rules mean.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from smp_gym.arrays import FloatArray
from smp_gym.compiling import kernel

__all__ = ["equal_arc", "passed_in_order"]


@kernel
def equal_arc(line: FloatArray, count: int) -> FloatArray:
    """Return `count` points of a line at equal steps of arc length.

    Args:
        line: (M, 3), at least one point; where it has no length, its last point is repeated.
        count: at least 2.

    Returns:
        (count, 3), the first and last being those of the line.
    """
    points = len(line)
    arc = np.zeros(points)
    for m in range(1, points):
        square = 0.0
        for axis in range(3):
            square += (line[m, axis] - line[m - 1, axis]) ** 2
        arc[m] = arc[m - 1] + math.sqrt(square)
    out = np.empty((count, 3))
    out[:] = line[points - 1]
    if arc[points - 1] == 0.0:
        return out
    step = arc[points - 1] / (count - 1)
    m = 0
    for k in range(count - 1):
        at = k * step
        # The last piece that begins at or before `at` has a length.
        while m + 2 < points and arc[m + 1] <= at:
            m += 1
        for axis in range(3):
            slope = (line[m + 1, axis] - line[m, axis]) / (arc[m + 1] - arc[m])
            out[k, axis] = line[m, axis] + slope * (at - arc[m])
    return out


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
