"""The choice of obstacles that together block most."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.compiling import kernel
from smp_gym.sampling.bitsets import ones, packed
from smp_gym.sampling.specification import DifficultySpecification
from smp_gym.scene import SHAPES

__all__ = ["REPEATED", "apart", "choose", "widths"]

_OVERLAP = 0.8
"""Least distance between the axes of obstacles, as a share of the sum of their widths."""

_PAIRED = 128
"""Number of the most blocking candidates that are compared in pairs."""

REPEATED = 0.1
_TIMES = 3
"""Value of blocking a trajectory again, for each obstacle that blocks it already, and the number of
those from which on it has none."""

_SWEEPS = 2
"""Times that each of the chosen is compared with all others in its place."""


def widths(rows: FloatArray) -> FloatArray:
    """Return the (C,) horizontal radius of obstacles, m."""
    widths: FloatArray = np.where(
        rows[:, 0] == SHAPES.index("box"), np.hypot(rows[:, 6], rows[:, 7]), rows[:, 6]
    )
    return widths


def apart(rows: FloatArray, others: FloatArray) -> BoolArray:
    """Return a mask (A, B) of pairs of obstacles that stand beside or over one another."""
    reach = _OVERLAP * (widths(rows)[:, None] + widths(others))
    distance = np.hypot(rows[:, None, 1] - others[:, 1], rows[:, None, 2] - others[:, 2])
    height = np.abs(rows[:, None, 3] - others[:, 3])
    beside: BoolArray = (distance >= reach) | (height >= rows[:, None, 8] + others[:, 8])
    return beside


def choose(
    rows: FloatArray,
    blocks: BoolArray,
    already: NDArray[np.int64],
    specification: DifficultySpecification,
) -> list[int] | None:
    """Choose obstacles that block most.

    The first two are the best of all pairs of the most blocking candidates, each further one adds
    most, and of more than two each is exchanged while another in its place adds more. A proposal
    that is blocked already still counts a little, so that its neighbours, which were not drawn, are
    blocked too.

    Args:
        rows: (C, 9) candidates.
        blocks: (C, N), which trajectories each blocks; the first, the mean, must be blocked.
        already: (N,), how many obstacles block a trajectory without these.
        specification: how many to choose, and how many of them, the last, on the table.

    Returns:
        Indices of the chosen; None if there are too few.
    """
    if specification.obstacles == 0:
        return []
    if not len(rows):
        return None
    order = np.argsort(-(blocks & (already == 0)).sum(axis=1), kind="stable")
    chosen = _choose(
        np.ascontiguousarray(rows[order]),
        widths(rows)[order],
        packed(blocks[order]),
        packed(already == np.arange(_TIMES)[:, None]),
        specification.obstacles,
        specification.on_table,
    )
    return None if chosen[0] < 0 else [int(index) for index in order[chosen]]


@kernel
def _beside(rows: FloatArray, width: FloatArray, a: int, b: int) -> bool:
    """Return whether two obstacles stand beside or over one another."""
    if abs(rows[a, 3] - rows[b, 3]) >= rows[a, 8] + rows[b, 8]:
        return True
    distance = math.hypot(rows[a, 1] - rows[b, 1], rows[a, 2] - rows[b, 2])
    return distance >= _OVERLAP * (width[a] + width[b])


@kernel
def _best_pair(rows: FloatArray, width: FloatArray, blocks: NDArray[np.uint64]) -> tuple[int, int]:
    """Return the two obstacles that together block most; the most blocking must come first.

    Bit 0 of `blocks` must be set in one of them.
    """
    first, second = -1, -1
    best = np.int64(-1)
    each = np.zeros(len(blocks), np.int64)
    for i in range(len(blocks)):
        for v in range(blocks.shape[1]):
            each[i] += ones(blocks[i, v])
    for i in range(len(blocks)):
        if 2 * each[i] <= best:
            break
        for j in range(i + 1, len(blocks)):
            # Those that follow block less still.
            if each[i] + each[j] <= best:
                break
            if not (blocks[i, 0] | blocks[j, 0]) & np.uint64(1):
                continue
            total = np.int64(0)
            for v in range(blocks.shape[1]):
                total += ones(blocks[i, v] | blocks[j, v])
            if total > best and _beside(rows, width, i, j):
                best, first, second = total, i, j
    return first, second


@kernel
def _best_at(
    slot: int,
    chosen: NDArray[np.int64],
    rows: FloatArray,
    width: FloatArray,
    blocks: NDArray[np.uint64],
    already: NDArray[np.uint64],
    on_table: bool,
) -> int:
    """Return the best candidate for a slot beside the other chosen, -1 if none fits there."""
    # The trajectories that nothing blocks, that one obstacle does, and so on.
    times = already.copy()
    for s in range(len(chosen)):
        if s != slot and chosen[s] >= 0:
            for v in range(times.shape[1]):
                word = blocks[chosen[s], v]
                for k in range(len(times) - 1, 0, -1):
                    times[k, v] = (times[k, v] & ~word) | (times[k - 1, v] & word)
                times[0, v] &= ~word
    mean = not times[0, 0] & np.uint64(1)
    best, worth = -1, -1.0
    for m in range(len(rows)):
        if (on_table and rows[m, 3] != rows[m, 8]) or not (mean or blocks[m, 0] & np.uint64(1)):
            continue
        value, weight = 0.0, 1.0
        for k in range(len(times)):
            count = np.int64(0)
            for v in range(times.shape[1]):
                count += ones(blocks[m, v] & times[k, v])
            value += weight * count
            weight *= REPEATED
        if value <= worth:
            continue
        fits = True
        for s in range(len(chosen)):
            if s != slot and chosen[s] >= 0 and not _beside(rows, width, m, chosen[s]):
                fits = False
        if fits:
            best, worth = m, value
    return best


@kernel
def _choose(
    rows: FloatArray,
    width: FloatArray,
    blocks: NDArray[np.uint64],
    already: NDArray[np.uint64],
    count: int,
    on_table: int,
) -> NDArray[np.int64]:
    """Return the (count,) indices of the chosen, the first -1 if there are too few."""
    chosen = np.full(count, -1)
    if count - on_table >= 2:
        new = blocks[:_PAIRED] & already[0]
        if not already[0, 0] & np.uint64(1):
            new[:, 0] |= np.uint64(1)
        pair = _best_pair(rows, width, new)
        if pair[0] < 0:
            return chosen
        chosen[0], chosen[1] = pair
    # Two are the best of all pairs already.
    for sweep in range(1 + (_SWEEPS if count > 2 else 0)):
        changed = False
        for slot in range(count):
            if sweep == 0 and chosen[slot] >= 0:
                continue
            table = slot >= count - on_table
            best = _best_at(slot, chosen, rows, width, blocks, already, table)
            if best < 0:
                chosen[0] = -1
                return chosen
            changed = changed or best != chosen[slot]
            chosen[slot] = best
        if sweep > 0 and not changed:
            break
    return chosen
