"""Polylines at equal steps of their arc, compiled.

The arrays are contiguous float64; all lengths are metres.
"""

from __future__ import annotations

import math

import numpy as np

from smp_gym.arrays import FloatArray
from smp_gym.compiling import kernel

__all__ = ["equal_arc", "equal_arc_chords"]


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
def equal_arc_chords(lines: FloatArray, count: int, parts: int) -> FloatArray:
    """Return the straight lines through points of polylines at equal steps of arc length.

    Args:
        lines: (P, M, 3), at least one point each.
        count: points at equal steps, at least 2.
        parts: into which the straight line between two of them is cut, at least 1.

    Returns:
        (P, (count - 1) * parts + 1, 3).
    """
    chords = np.empty((len(lines), (count - 1) * parts + 1, 3))
    for p in range(len(lines)):
        points = equal_arc(lines[p], count)
        for k in range(count - 1):
            for part in range(parts):
                share = part / parts
                for axis in range(3):
                    along = points[k + 1, axis] - points[k, axis]
                    chords[p, k * parts + part, axis] = points[k, axis] + share * along
        chords[p, -1] = points[count - 1]
    return chords
