"""Clutter: many solids of mixed shape and size around a witness, standing, stacked or hanging.

As with single obstacles the witness is drawn first, out of the wide detours of a family. Stacks
and hanging solids are then taken, one after the other, out of many random ones: always that which
blocks most of what the ones before have left free.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.sampling import kernels
from smp_gym.sampling.choice import REPEATED, widths
from smp_gym.sampling.conversion import fixture_rows
from smp_gym.sampling.draws import Draw
from smp_gym.sampling.family import BLOCKING_DEPTH, Family, draw_family, member
from smp_gym.sampling.obstacles import fits
from smp_gym.sampling.transfer import Query
from smp_gym.sampling.witness import is_witness
from smp_gym.scene import SHAPES

__all__ = ["CLUTTER", "HALF_EXTENTS", "ClutterSpecification", "clutter"]


@dataclass(frozen=True)
class ClutterSpecification:
    """The settings of a difficulty of clutter.

    Attributes:
        solids: how many.
        clearance: m, what every solid leaves between itself and the witness's spheres.
        free_share: share of the proposals that may stay free; where more do, it is drawn anew.
    """

    solids: int
    clearance: float
    free_share: float


CLUTTER = {
    "easy": ClutterSpecification(6, clearance=0.030, free_share=0.25),
    "medium": ClutterSpecification(12, clearance=0.020, free_share=0.10),
    "hard": ClutterSpecification(16, clearance=0.010, free_share=0.05),
}

HALF_EXTENTS = (0.015, 0.06)
"""Range of the half-extents of solids, m."""

_SHAPE_SHARES = (0.45, 0.35, 0.2)
_STACK_SHARES = (0.15, 0.25, 0.35, 0.25)
_OFF_CENTRE = 0.5
"""Shares of `SHAPES` and of stacks of one, two, ... solids; how far off the middle of what is below
it a solid stands, as a share of what would leave it wholly supported."""

_HANGING_SHARE = 0.4
_LOWEST_HANGING = 0.22
_MOST_HANGING = 1 / 3
"""Share of what is drawn that hangs, how high above the table at least, m, and the largest share of
the solids that may hang."""

_ROUNDS = (0.6, 1.0)
_CANDIDATES = 240
"""Share of the solids that are there after each round, and number of stacks and hanging solids
drawn in each."""

_APART = 0.002
"""Least distance between solids that do not stand on one another, m."""

_WORTH_OF_MEAN = 30.0
_MEAN_SHARE = 0.3
"""As many members as blocking the mean of the demonstrations is worth, and share of what is drawn
that is near it while it is free."""

_FAMILIES = 3
_WITNESSES = 4
"""Numbers of families tried for a goal, and of members of each tried as the witness."""

_GRID_DEPTH = BLOCKING_DEPTH + 0.01
_HAND_LINK = 5
_NO_ROWS = np.empty((0, kernels.OBSTACLE_COLUMNS))


def _draw_stacks(
    points: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, NDArray[np.int64], BoolArray]:
    """Draw for each point (C, 3) m a solid that hangs there or a stack on the table below it.

    Returns:
        Rows (M, 9) of all solids, those of a stack one after the other; (C,) index of the first of
        each; (C,) which hang.
    """
    most = len(_STACK_SHARES)
    count = 1 + rng.choice(most, size=len(points), p=_STACK_SHARES)
    hangs = rng.uniform(size=len(points)) < _HANGING_SHARE
    count[hangs] = 1
    there = np.arange(most) < count[:, None]
    shape = rng.choice(len(_SHAPE_SHARES), size=there.shape, p=_SHAPE_SHARES)
    box, cylinder, ball = (SHAPES.index(name) for name in ("box", "cylinder", "sphere"))
    # Nothing stands on a ball.
    shape[(shape == ball) & (np.arange(most) < count[:, None] - 1)] = cylinder
    size = rng.uniform(*HALF_EXTENTS, size=(*there.shape, 3))
    # The widest is the lowest.
    flat = np.where(there[..., None], size[..., :2], 0.0)
    size[..., :2] = np.take_along_axis(
        size[..., :2], np.argsort(-flat.min(axis=-1), axis=1, kind="stable")[..., None], axis=1
    )
    width = size[..., :2].min(axis=-1)
    size[shape != box, :2] = width[shape != box, None]
    size[shape == ball, 2] = width[shape == ball]
    reach = _OFF_CENTRE * np.maximum(0.0, width[:, :-1] - width[:, 1:]) / np.sqrt(2.0)
    shift = reach[..., None] * rng.uniform(-1.0, 1.0, size=(*reach.shape, 2))
    position = np.empty((*there.shape, 3))
    position[:, 0, :2] = points[:, :2]
    position[:, 1:, :2] = points[:, None, :2] + np.cumsum(shift, axis=1)
    position[..., 2] = 2.0 * np.cumsum(size[..., 2], axis=1) - size[..., 2]
    lowest = _LOWEST_HANGING + size[:, 0, 2]
    position[hangs, 0, 2] = np.maximum(points[:, 2], lowest)[hangs]
    yaw = np.broadcast_to(rng.uniform(-np.pi, np.pi, size=(len(points), 1)), there.shape)
    rows = np.concatenate(
        [shape[..., None], position, np.cos(yaw)[..., None], np.sin(yaw)[..., None], size], axis=-1
    )
    return rows[there], np.cumsum(count) - count, hangs


def _near_hand(
    query: Query, family: Family, which: BoolArray, rng: np.random.Generator
) -> FloatArray:
    """Return (C, 3) m, places of the hand on members (N,) of a family."""
    pool = np.flatnonzero(which if which.any() else family.free)
    hand = np.flatnonzero(query.transfer.spheres.link[query.transfer.swept] >= _HAND_LINK)
    chosen = pool[rng.integers(len(pool), size=_CANDIDATES)]
    if which[0]:
        # The mean must be blocked.
        chosen[rng.uniform(size=_CANDIDATES) < _MEAN_SHARE] = 0
    return family.paths[
        chosen,
        rng.integers(query.transfer.samples, size=_CANDIDATES),
        hand[rng.integers(len(hand), size=_CANDIDATES)],
    ]


def _overlap(rows: FloatArray, others: FloatArray) -> BoolArray:
    """Return a mask (A, B) of pairs of solids that are neither beside nor over one another."""
    distance = np.hypot(rows[:, None, 1] - others[:, 1], rows[:, None, 2] - others[:, 2])
    height = np.abs(rows[:, None, 3] - others[:, 3])
    beside = distance >= widths(rows)[:, None] + widths(others) + _APART
    over = height >= rows[:, None, 8] + others[:, 8] + _APART
    return np.asarray(~(beside | over))


def _fill(
    query: Query,
    family: Family,
    witnesses: list[FloatArray],
    others: FloatArray,
    specification: ClutterSpecification,
    rng: np.random.Generator,
) -> FloatArray | None:
    """Return (M, 9) rows that leave witnesses (W, 6) clear; None if there is no room for all."""
    transfer, clearance = query.transfer, specification.clearance
    kept = [transfer.looks(witness) for witness in witnesses]
    chosen = _NO_ROWS
    # What is blocked already still counts a little: its neighbours, which were not drawn, do too.
    weight = family.free * REPEATED ** family.blocked(others).sum(axis=0)
    weight[0] *= _WORTH_OF_MEAN
    may_hang = int(_MOST_HANGING * specification.solids)
    for share in _ROUNDS:
        rows, first, hangs = _draw_stacks(_near_hand(query, family, weight >= 1.0, rng), rng)
        counts = np.diff(first, append=len(rows))
        good = fits(query, rows) & ~_overlap(rows, np.concatenate([others, chosen])).any(axis=1)
        for looks in kept:
            good[good] = looks.clear(rows[good], clearance)
        possible = np.logical_and.reduceat(good, first)
        blocks = np.logical_or.reduceat(family.near(rows, -_GRID_DEPTH), first)
        goal = round(share * specification.solids)
        while len(chosen) < goal:
            now = possible & (counts <= goal - len(chosen)) & ~(hangs & (may_hang == 0))
            if not now.any():
                return None
            # By solid, but less so: a stack is worth more than what it blocks alone.
            value = (blocks @ weight) / np.sqrt(counts)
            best = int(np.where(now, value, -1.0).argmax())
            stack = rows[first[best] : first[best] + counts[best]]
            chosen = np.concatenate([chosen, stack])
            may_hang -= int(hangs[best])
            weight = np.where(blocks[best], weight * REPEATED, weight)
            possible &= ~np.logical_or.reduceat(_overlap(rows, stack).any(axis=1), first)
    return chosen


def clutter(
    query: Query,
    specification: ClutterSpecification,
    rng: np.random.Generator,
    before: Draw | None = None,
) -> Draw | None:
    """Draw a witness, and clutter around it; None if they do not fit together.

    Args:
        query: which transfer to which goal.
        specification: of the solids for this goal.
        rng: source of all randomness.
        before: what was drawn for another goal: its witness stays one, and its solids are in the
            result, too.

    Raises:
        UnreachableError: the goal is out of reach.
    """
    transfer, clearance = query.transfer, specification.clearance
    others = _NO_ROWS if before is None else before.rows
    earlier = [] if before is None or before.witness is None else [before.witness]
    bodies = fixture_rows(query.goals)
    for _ in range(_FAMILIES):
        family = draw_family(query, transfer.proposals, transfer.wide, rng)
        able = family.able & ~family.near(others, clearance).any(axis=0)
        able[: family.proposals] = False
        for index in rng.permutation(np.flatnonzero(able))[:_WITNESSES]:
            witness = member(transfer, family, int(index))
            if not is_witness(transfer, witness, bodies, others, clearance):
                continue
            rows = _fill(query, family, [witness, *earlier], others, specification, rng)
            if rows is None or len(np.unique(rows[:, 0])) == 1:
                continue
            together = np.concatenate([others, rows])
            free = family.free & ~family.blocked(together).any(axis=0)
            if not free[0] and family.shares(free)[0] <= specification.free_share:
                return Draw(transfer.start, query.goals, together, [witness, *earlier][-1])
    return None
