"""Obstacles on two legs: candidates near the proposals, and the choice of those that block most.

A trajectory is free where both its legs are, so the share of free ones is the product of the shares
of free legs, and that is what is made small. A witness is needed on each leg.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.compiling import kernel
from smp_gym.sampling.bitsets import ones, packed
from smp_gym.sampling.choice import REPEATED, apart
from smp_gym.sampling.obstacles import BASE_DISTANCE, draw_rows
from smp_gym.sampling.specification import DifficultySpecification
from smp_gym.tasks.push_lift_box.legs import LegFamily

__all__ = ["SPARE", "LegCandidates", "choose_on_legs", "compare_on_legs", "draw_on_legs"]
Words = NDArray[np.uint64]

_HAND_LINK = 5
_CANDIDATES = 500
_COMPARED = 240
_PAIRED = 100
SPARE = 5
"""Numbers: of candidates drawn, of the most blocking that are compared, of those compared in pairs;
and of members that have to be clear of all chosen: the grid is coarse, not all of them will be."""


def draw_on_legs(families: tuple[LegFamily, LegFamily], rng: np.random.Generator) -> FloatArray:
    """Return rows of obstacles near the hand's paths on both legs, over the table."""
    points, reach = [], []
    for family in families:
        count = _CANDIDATES // 2
        spheres = np.flatnonzero(family.leg.spheres.link[family.leg.outline] >= _HAND_LINK)
        member = rng.integers(family.proposals, size=count)
        sample = rng.integers(family.paths.shape[1], size=count)
        sphere = spheres[rng.integers(len(spheres), size=count)]
        points.append(family.paths[member, sample, sphere])
        reach.append(family.leg.spheres.radius[family.leg.outline[sphere]])
    rows = draw_rows(np.concatenate(points), np.concatenate(reach), 1.0, rng)
    fits = np.hypot(rows[:, 1], rows[:, 2]) >= BASE_DISTANCE
    return rows[fits & (rows[:, 3] >= rows[:, 8])]


@kernel
def _common(a: Words, b: Words) -> np.int64:
    """Return the number of bits that are set in both."""
    count = np.int64(0)
    for w in range(len(a)):
        count += ones(a[w] & b[w])
    return count


@kernel
def _best_pair(
    blocks: tuple[Words, Words],
    counts: tuple[int, int],
    clears: tuple[Words, Words],
    allowed: BoolArray,
    repeated: float,
    spare: int,
) -> tuple[int, int]:
    """Return the two candidates that block most and clear `spare` on both legs, or (-1, -1)."""
    first, second, best = -1, -1, np.inf
    one = np.uint64(1)
    for i in range(len(allowed)):
        for j in range(i):
            if not allowed[i, j]:
                continue
            if not ((blocks[0][i, 0] | blocks[0][j, 0] | blocks[1][i, 0] | blocks[1][j, 0]) & one):
                continue
            left = 1.0
            for leg in range(2):
                either, both = np.int64(0), np.int64(0)
                for w in range(blocks[leg].shape[1]):
                    either += ones(blocks[leg][i, w] | blocks[leg][j, w])
                    both += ones(blocks[leg][i, w] & blocks[leg][j, w])
                left *= counts[leg] - (1.0 - repeated) * (either + repeated * both)
            if left >= best:
                continue
            if (
                _common(clears[0][i], clears[0][j]) >= spare
                and _common(clears[1][i], clears[1][j]) >= spare
            ):
                first, second, best = i, j, left
    return first, second


@dataclass(frozen=True, eq=False)
class LegCandidates:
    """Candidates, the most blocking first, that leave a member clear on both legs.

    Attributes:
        rows: (C, 9).
        blocks: (C, P) for each leg, which proposals that the table leaves free each blocks.
        clears: (C, N) for each leg, from which able members each keeps its clearance.
        free: how many proposals the table leaves free, on each leg.
    """

    rows: FloatArray
    blocks: tuple[BoolArray, BoolArray]
    clears: tuple[BoolArray, BoolArray]
    free: tuple[int, int]


def compare_on_legs(
    rows: FloatArray, families: tuple[LegFamily, LegFamily], clearance: float
) -> LegCandidates:
    """Return the most blocking candidates of (C, 9), compared on two legs."""
    blocks = [family.blocks(rows) for family in families]
    clears = [family.clears(rows, clearance) for family in families]
    free = [int(family.free.sum()) for family in families]
    left = np.prod([n - b.sum(axis=1) for n, b in zip(free, blocks, strict=True)], axis=0)
    enough = [clear.sum(axis=1) >= SPARE for clear in clears]
    usable = np.flatnonzero(enough[0] & enough[1])
    order = usable[np.argsort(left[usable], kind="stable")][:_COMPARED]
    return LegCandidates(
        rows=rows[order],
        blocks=(blocks[0][order], blocks[1][order]),
        clears=(clears[0][order], clears[1][order]),
        free=(free[0], free[1]),
    )


def choose_on_legs(
    candidates: LegCandidates,
    able: tuple[BoolArray, BoolArray],
    specification: DifficultySpecification,
) -> list[int] | None:
    """Choose obstacles that leave few trajectories free, but some clear on each leg.

    The first two are the best of all pairs of the most blocking candidates; each further one adds
    most. A proposal that is blocked already still counts a little, so that its neighbours, which
    were not drawn, are blocked too.

    Args:
        candidates: to choose from.
        able: (N,) for each leg, which members may serve as witness.
        specification: how many to choose, and how many of them on the table.

    Returns:
        Indices of the chosen; None if too few would be left clear.
    """
    rows, blocks = candidates.rows, candidates.blocks
    clears = [clear & may for clear, may in zip(candidates.clears, able, strict=True)]
    standing = rows[:, 3] == rows[:, 8]
    first, second = _best_pair(
        (packed(blocks[0][:_PAIRED]), packed(blocks[1][:_PAIRED])),
        candidates.free,
        (packed(clears[0][:_PAIRED]), packed(clears[1][:_PAIRED])),
        apart(rows[:_PAIRED], rows[:_PAIRED]),
        REPEATED,
        SPARE,
    )
    if first < 0:
        return None
    chosen = [first, second]
    while len(chosen) < specification.obstacles:
        left = np.ones(len(rows))
        allowed = apart(rows, rows[chosen]).all(axis=1)
        if len(chosen) >= specification.obstacles - specification.on_table:
            allowed &= standing
        for block, clear in zip(blocks, clears, strict=True):
            # Proposals that the table does not leave free are blocked by none, and count for all.
            weight = REPEATED ** block[chosen].sum(axis=0)
            left *= weight.sum() - (1.0 - REPEATED) * (block * weight).sum(axis=1)
            allowed &= (clear & clear[chosen].all(axis=0)).sum(axis=1) >= SPARE
        if not allowed.any():
            return None
        chosen.append(int(np.argmin(np.where(allowed, left, np.inf))))
    return chosen
