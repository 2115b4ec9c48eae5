"""Clutter: many solids of mixed shape and size around a witness, standing, stacked or hanging.

As with single obstacles the witness is drawn first, out of the wide detours of a family. Solids
are then taken, one after the other, out of many random ones: always that which blocks most of what
the ones before have left free. Half of them stand on the table or hang; the rest come in two
rounds, in which what stands may also carry another solid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.sampling import kernels
from smp_gym.sampling.bodies import standing
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
    "easy": ClutterSpecification(6, clearance=0.030, free_share=0.20),
    "medium": ClutterSpecification(12, clearance=0.020, free_share=0.05),
    "hard": ClutterSpecification(16, clearance=0.010, free_share=0.02),
}

HALF_EXTENTS = (0.015, 0.06)
"""Range of the half-extents of solids, m."""

_SHAPE_SHARES = (0.45, 0.35, 0.2)
_HANGING_SHARE = 0.4
_LOWEST_HANGING = 0.10
"""Shares of `SHAPES`, share of the solids that hang, and how high above the table at least, m."""

_SIZE_CLASSES = (0.032, 0.046)
"""Greatest half-extent of small and of middle-sized solids, m: the sizes take turns, as the largest
would always block most."""

_ROUNDS = (0.5, 0.75, 1.0)
"""Share of the solids that are there after each round."""

_CANDIDATES = 300
_ON_TOP = 6
_OFF_CENTRE = 0.5
"""Numbers of solids drawn in each round, and of those drawn upon each that stands; how far off its
axis these are at most, as a share of its least half-extent."""

_APART = 0.002
"""Least distance between solids that do not stand on one another, m."""

_FAMILIES = 3
_WITNESSES = 3
_GLANCE = 8
"""Numbers of families tried for a goal, and of members of each tried as the witness; every
so-many-th sample of the witness is looked at first."""

_GRID_DEPTH = BLOCKING_DEPTH + 0.01
_HAND_LINK = 5
_NO_ROWS = np.empty((0, kernels.OBSTACLE_COLUMNS))


def _draw_solids(count: int, rng: np.random.Generator) -> FloatArray:
    """Return (count, 9) rows of random solids at the origin."""
    shape = rng.choice(len(_SHAPE_SHARES), size=count, p=_SHAPE_SHARES)
    size = rng.uniform(*HALF_EXTENTS, size=(count, 3))
    box, ball = SHAPES.index("box"), SHAPES.index("sphere")
    size[shape != box, 1] = size[shape != box, 0]
    size[shape == ball, 2] = size[shape == ball, 0]
    yaw = rng.uniform(-np.pi, np.pi, size=count)
    return np.column_stack([shape, np.zeros((count, 3)), np.cos(yaw), np.sin(yaw), size])


def _around(query: Query, family: Family, free: BoolArray, rng: np.random.Generator) -> FloatArray:
    """Return rows of solids that stand below or hang at the hand on free members (N,)."""
    rows = _draw_solids(_CANDIDATES, rng)
    pool = np.flatnonzero(free if free.any() else family.free)
    if not len(pool):
        return _NO_ROWS
    hand = np.flatnonzero(query.transfer.spheres.link[query.transfer.swept] >= _HAND_LINK)
    at = (
        pool[rng.integers(len(pool), size=len(rows))],
        rng.integers(query.transfer.samples, size=len(rows)),
        hand[rng.integers(len(hand), size=len(rows))],
    )
    rows[:, 1:4] = family.paths[at]
    hangs = rng.uniform(size=len(rows)) < _HANGING_SHARE
    lowest = rows[:, 8] + _LOWEST_HANGING
    rows[:, 3] = np.where(hangs, np.maximum(rows[:, 3], lowest), rows[:, 8])
    return rows


def _upon(rows: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return rows of solids that stand on the flat ones of the given (C, 9), near their middles."""
    flat = rows[rows[:, 0] != SHAPES.index("sphere")].repeat(_ON_TOP, axis=0)
    upper = _draw_solids(len(flat), rng)
    reach = _OFF_CENTRE * flat[:, 6:8].min(axis=1)
    upper[:, 1:3] = flat[:, 1:3] + reach[:, None] * rng.uniform(-0.7, 0.7, size=(len(flat), 2))
    upper[:, 3] = flat[:, 3] + flat[:, 8] + upper[:, 8]
    return upper


def _overlap(rows: FloatArray, others: FloatArray) -> BoolArray:
    """Return a mask (A, B) of pairs of solids that are neither beside nor over one another."""
    distance = np.hypot(rows[:, None, 1] - others[:, 1], rows[:, None, 2] - others[:, 2])
    height = np.abs(rows[:, None, 3] - others[:, 3])
    beside = distance >= widths(rows)[:, None] + widths(others) + _APART
    over = height >= rows[:, None, 8] + others[:, 8] - 1e-9
    return np.asarray(~(beside | over))


def _fill(
    query: Query,
    family: Family,
    witnesses: list[FloatArray],
    others: FloatArray,
    solids: int,
    clearance: float,
    rng: np.random.Generator,
) -> FloatArray | None:
    """Return (solids, 9) rows that leave witnesses (W, 6) clear; None if there is no room."""
    transfer = query.transfer
    chosen = _NO_ROWS
    # What is blocked already still counts a little: its neighbours, which were not drawn, do too.
    weight = family.free * REPEATED ** family.blocked(others).sum(axis=0)
    for share in _ROUNDS:
        rows = _around(query, family, family.free & (weight == 1.0), rng)
        rows = np.concatenate([rows, _upon(chosen[standing(chosen)], rng)])
        rows = rows[fits(query, rows) & ~_overlap(rows, np.concatenate([others, chosen])).any(1)]
        for witness in witnesses:
            for samples in (witness[::_GLANCE], witness):
                rows = rows[transfer.clearances(samples, rows, clearance) >= clearance]
        blocks = family.near(rows, -_GRID_DEPTH)
        category = np.digitize(rows[:, 6:].max(axis=1), _SIZE_CLASSES)
        possible = np.ones(len(rows), np.bool_)
        while len(chosen) < round(share * solids):
            now = possible & (category == len(chosen) % (len(_SIZE_CLASSES) + 1))
            now = now if now.any() else possible
            if not now.any():
                return None
            best = int(np.where(now, blocks @ weight, -1.0).argmax())
            chosen = np.concatenate([chosen, rows[best : best + 1]])
            weight = np.where(blocks[best], weight * REPEATED, weight)
            possible &= ~_overlap(rows, rows[best : best + 1])[:, 0]
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
            rows = _fill(
                query,
                family,
                [witness, *earlier],
                others,
                specification.solids,
                clearance,
                rng,
            )
            if rows is None:
                continue
            together = np.concatenate([others, rows])
            free = family.free & ~family.blocked(together).any(axis=0)
            if not free[0] and family.shares(free)[0] <= specification.free_share:
                return Draw(transfer.start, query.goals, together, [witness, *earlier][-1])
    return None
