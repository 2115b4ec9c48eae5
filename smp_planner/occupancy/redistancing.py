"""From any function that is positive inside to signed distance, on a regular grid.

A classifier says where the surface is, but not how far: its logit is neither a distance nor
proportional to one. Here the distance of its zero level is computed by fast sweeping (Zhao 2005, "A
fast sweeping method for eikonal equations", Math. Comp. 74).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from smp_gym.compiling import kernel

__all__ = ["redistance"]


@kernel
def _crossing(level, i, j, k, axis, spacing):  # type: ignore[no-untyped-def]
    """Distance along one axis to the nearest change of sign next to a node, or infinity."""
    here, best = level[i, j, k], np.inf
    for step in (-1, 1):
        ni = i + step * (axis == 0)
        nj = j + step * (axis == 1)
        nk = k + step * (axis == 2)
        if not (0 <= ni < level.shape[0] and 0 <= nj < level.shape[1] and 0 <= nk < level.shape[2]):
            continue
        there = level[ni, nj, nk]
        if (here > 0.0) != (there > 0.0):
            best = min(best, spacing * here / (here - there))
    return best


@kernel
def _start(level, spacing, distance, fixed):  # type: ignore[no-untyped-def]
    """Set the nodes next to the surface to their distance to the plane through its crossings."""
    for i in range(level.shape[0]):
        for j in range(level.shape[1]):
            for k in range(level.shape[2]):
                total = 0.0
                for axis in range(3):
                    crossing = _crossing(level, i, j, k, axis, spacing)
                    if crossing < np.inf:
                        total += 1.0 / max(crossing, 1e-9 * spacing) ** 2
                if total > 0.0:
                    distance[i, j, k] = 1.0 / math.sqrt(total)
                    fixed[i, j, k] = True


@kernel
def _solve(a, b, c, h):  # type: ignore[no-untyped-def]
    """Smallest x with sum of max(x - neighbour, 0)^2 = h^2 over the neighbours a, b, c."""
    if a > b:
        a, b = b, a
    if b > c:
        b, c = c, b
    if a > b:
        a, b = b, a
    x = a + h
    if x > b:
        x = 0.5 * (a + b + math.sqrt(max(2.0 * h * h - (a - b) ** 2, 0.0)))
        if x > c:
            s = a + b + c
            q = s * s - 3.0 * (a * a + b * b + c * c - h * h)
            x = (s + math.sqrt(max(q, 0.0))) / 3.0
    return x


@kernel
def _sweep(distance, fixed, spacing, limit):  # type: ignore[no-untyped-def]
    nx, ny, nz = distance.shape
    for order in range(8):
        for ii in range(nx):
            i = ii if order & 1 else nx - 1 - ii
            for jj in range(ny):
                j = jj if order & 2 else ny - 1 - jj
                for kk in range(nz):
                    k = kk if order & 4 else nz - 1 - kk
                    if fixed[i, j, k]:
                        continue
                    a, b, c = limit, limit, limit
                    if i > 0:
                        a = min(a, distance[i - 1, j, k])
                    if i < nx - 1:
                        a = min(a, distance[i + 1, j, k])
                    if j > 0:
                        b = min(b, distance[i, j - 1, k])
                    if j < ny - 1:
                        b = min(b, distance[i, j + 1, k])
                    if k > 0:
                        c = min(c, distance[i, j, k - 1])
                    if k < nz - 1:
                        c = min(c, distance[i, j, k + 1])
                    if min(a, b, c) < limit:
                        x = _solve(a, b, c, spacing)
                        if x < distance[i, j, k]:
                            distance[i, j, k] = x


def redistance(
    level: NDArray[np.floating], spacing: float, truncation: float
) -> NDArray[np.float32]:
    """Return the signed distance to the zero level of a function on a grid.

    Args:
        level: (X, Y, Z), positive inside, of any scale.
        spacing: m, distance of neighbouring nodes.
        truncation: m, largest absolute value of the result.

    Returns:
        (X, Y, Z) float32 m, negative inside. The error is of the order of a quarter of the spacing;
        what is thinner than the spacing may be lost.

    Raises:
        ValueError: `level` is not a finite array with three axes.
    """
    values = np.ascontiguousarray(level, np.float64)
    if values.ndim != 3 or not np.isfinite(values).all():
        raise ValueError(f"level must be a finite array with 3 axes, got shape {values.shape}")
    distance = np.full(values.shape, truncation)
    fixed = np.zeros(values.shape, np.bool_)
    _start(values, spacing, distance, fixed)
    _sweep(distance, fixed, spacing, truncation)
    signed = np.where(values > 0.0, -distance, distance)
    return np.clip(signed, -truncation, truncation).astype(np.float32)
