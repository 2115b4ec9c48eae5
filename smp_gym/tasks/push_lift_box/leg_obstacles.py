"""Obstacles on two legs: bodies grown towards a reference, and the choice of those that block most.

A trajectory is free where both its legs are, so the share of free ones is the product of the shares
of free legs, and that is what is made small. The reference trajectory is drawn first, and every
body is as large as the clearance that it keeps from it allows: the opening is where the reference
is, high, low, left or right, and no one detour passes through those of many scenes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from smp_gym.arrays import BoolArray, FloatArray, IntArray
from smp_gym.sampling import kernels
from smp_gym.sampling.choice import REPEATED
from smp_gym.sampling.obstacles import BASE_DISTANCE
from smp_gym.scene import SHAPES
from smp_gym.tasks.push_lift_box.legs import LegFamily

__all__ = ["GrowingBodies", "choose_on_legs", "draw_on_legs", "grown"]

CEILING = 1.0
"""Height, m, from which hanging bodies hang."""

KINDS = ("post", "hanging", "beam", "panel", "block")
SHARES = (0.25, 0.3, 0.2, 0.1, 0.15)
"""Kinds of bodies and their shares: standing on the table; hanging from `CEILING`; lying across at
some height; thin walls that stand on the table; solids in mid air."""

_HAND_LINK = 4
_CANDIDATES = 420
_COMPARED = 220
"""Numbers of bodies drawn, and of the most blocking of them to choose from."""

_TURN = 0.15
"""rad, standard deviation of a body's turn from the sides of the table."""

_PARTLY = 0.3
"""Largest share of the growth where bodies do not grow as far as there is room."""

_HALVINGS = 6
_LATTICE = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 4)] * 3, indexing="ij"), -1).reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class GrowingBodies:
    """Bodies of which each has a least and a greatest size.

    Attributes:
        least: (C, 9) rows, see `smp_gym.sampling.kernels`.
        most: (C, 9) rows of the same shapes and turns.
    """

    least: FloatArray
    most: FloatArray

    def at(self, share: FloatArray) -> FloatArray:
        """Return the rows (C, 9) between least and greatest, by shares (C,) from 0 to 1."""
        rows: FloatArray = self.least + share[:, None] * (self.most - self.least)
        return rows


def grown(bodies: GrowingBodies, keeps: Callable[[FloatArray], BoolArray]) -> FloatArray:
    """Return the rows of bodies, each as large as may be; those that are too large at least, not.

    Args:
        bodies: to grow.
        keeps: whether rows (C, 9) keep all distances that they must keep.
    """
    fits = keeps(bodies.least)
    bodies = GrowingBodies(bodies.least[fits], bodies.most[fits])
    low, step = np.zeros(len(bodies.least)), 0.5
    whole = keeps(bodies.most)
    low[whole] = 1.0
    open_ = np.flatnonzero(~whole)
    for _ in range(_HALVINGS):
        tried = low[open_] + step
        rows = bodies.least[open_] + tried[:, None] * (bodies.most[open_] - bodies.least[open_])
        low[open_] = np.where(keeps(rows), tried, low[open_])
        step *= 0.5
    return bodies.at(low)


def grown_partly(
    bodies: GrowingBodies, keeps: Callable[[FloatArray], BoolArray], rng: np.random.Generator
) -> FloatArray:
    """Return the rows of bodies, grown by random shares, without those too large.

    Args:
        bodies: to grow.
        keeps: whether rows (C, 9) keep all distances that they must keep.
        rng: source of all randomness.
    """
    rows = bodies.at(rng.uniform(0.0, _PARTLY, len(bodies.least)))
    return rows[keeps(rows)]


def draw_on_legs(families: tuple[LegFamily, LegFamily], rng: np.random.Generator) -> GrowingBodies:
    """Return bodies near the paths of hand and forearm on both legs, over the table."""
    points = []
    for family in families:
        count = _CANDIDATES // 2
        spheres = np.flatnonzero(family.leg.spheres.link[family.leg.outline] >= _HAND_LINK)
        member = rng.integers(len(family.paths), size=count)
        sample = rng.integers(family.paths.shape[1], size=count)
        sphere = spheres[rng.integers(len(spheres), size=count)]
        points.append(family.paths[member, sample, sphere])
    bodies = _bodies(np.concatenate(points) + rng.normal(0.0, 0.05, (2 * count, 3)), rng)
    far = np.hypot(bodies.least[:, 1], bodies.least[:, 2]) >= BASE_DISTANCE
    return GrowingBodies(bodies.least[far], bodies.most[far])


def _bodies(points: FloatArray, rng: np.random.Generator) -> GrowingBodies:
    """Return bodies of all kinds at points (C, 3)."""
    count = len(points)
    kind = rng.choice(len(KINDS), size=count, p=SHARES)
    post, hanging, beam, panel, block = (kind == index for index in range(len(KINDS)))
    shape = np.where(
        (post | hanging | block) & (rng.uniform(size=count) < 0.4),
        SHAPES.index("cylinder"),
        SHAPES.index("box"),
    ).astype(np.float64)
    shape[block & (rng.uniform(size=count) < 0.3)] = SHAPES.index("sphere")
    # Like what people put up, they stand along the table's sides, about.
    yaw = 0.5 * np.pi * rng.integers(4, size=count) + rng.normal(0.0, _TURN, count)
    least, most = np.empty((count, 9)), np.empty((count, 9))
    for rows in (least, most):
        rows[:, 0], rows[:, 4], rows[:, 5] = shape, np.cos(yaw), np.sin(yaw)
        rows[:, 1:4] = points
    girth = rng.uniform(0.02, 0.06, (count, 2))
    least[:, 6:8], most[:, 6:8] = girth, girth
    # Posts grow upwards, what hangs grows down.
    least[:, 8], most[:, 8] = 0.02, rng.uniform(0.15, 0.4, count)
    drop = rng.uniform(0.25, 0.45, count)
    most[hanging, 8] = drop[hanging]
    least[hanging, 8] = 0.1
    for rows in (least, most):
        rows[post, 3] = rows[post, 8]
        rows[hanging, 3] = CEILING - rows[hanging, 8]
    # Beams and panels grow in length.
    thickness = rng.uniform(0.015, 0.03, count)
    length = rng.uniform(0.12, 0.35, count)
    for rows, half in ((least, np.full(count, 0.03)), (most, length)):
        rows[beam | panel, 6] = half[beam | panel]
        rows[beam | panel, 7] = thickness[beam | panel]
        rows[beam, 8] = thickness[beam]
        height = np.maximum(points[:, 2], 0.08) / 2
        rows[panel, 8] = height[panel]
        rows[panel, 3] = height[panel]
        rows[beam, 3] = np.maximum(points[beam, 2], thickness[beam])
    size = rng.uniform(0.04, 0.09, (count, 3))
    least[block, 6:] = 0.02
    most[block, 6:] = size[block]
    for rows in (least, most):
        round_ = shape != SHAPES.index("box")
        rows[round_, 7] = rows[round_, 6]
        ball = shape == SHAPES.index("sphere")
        rows[ball, 8] = rows[ball, 6]
        rows[block, 3] = np.maximum(points[block, 2], most[block, 8])
    return GrowingBodies(least, most)


def _lattices(rows: FloatArray) -> FloatArray:
    """Return (C, L, 3) m, points of a lattice in each body."""
    points = _LATTICE * rows[:, None, 6:]
    c, s = rows[:, 4, None], rows[:, 5, None]
    x, y = points[..., 0].copy(), points[..., 1].copy()
    points[..., 0], points[..., 1] = c * x - s * y, s * x + c * y
    return np.ascontiguousarray(points + rows[:, None, 1:4])


def _disjoint(rows: FloatArray, lattices: FloatArray, one: int) -> BoolArray:
    """Return a mask (C,) of the bodies that do not run through one of them."""
    own = kernels.point_distances(lattices[one], rows).min(axis=1) > 0.0
    theirs = kernels.point_distances(lattices.reshape(-1, 3), rows[one : one + 1])[0]
    return np.asarray(own & (theirs.reshape(len(rows), -1).min(axis=1) > 0.0))


def choose_on_legs(
    rows: FloatArray, families: tuple[LegFamily, LegFamily], count: int
) -> IntArray | None:
    """Choose bodies, each of which adds most to what is blocked.

    A trajectory that is blocked already still counts a little, so that its neighbours, which were
    not drawn, are blocked too.

    Args:
        rows: (C, 9) candidates.
        families: of approaches and lifts, whose members are to be blocked.
        count: how many bodies to choose.

    Returns:
        Indices of the chosen; None if there are too few that do not run through each other.
    """
    blocks = [family.blocks(rows) for family in families]
    left = np.prod([b.shape[1] - b.sum(axis=1) for b in blocks], axis=0)
    order = np.argsort(left, kind="stable")[:_COMPARED]
    rows, blocks = rows[order], [block[order] for block in blocks]
    allowed, lattices = np.ones(len(rows), np.bool_), _lattices(rows)
    weights = [np.ones(block.shape[1]) for block in blocks]
    chosen: list[int] = []
    while len(chosen) < count:
        if not allowed.any():
            return None
        left = np.ones(len(rows))
        for block, weight in zip(blocks, weights, strict=True):
            left *= weight.sum() - (1.0 - REPEATED) * (block * weight).sum(axis=1)
        best = int(np.argmin(np.where(allowed, left, np.inf)))
        chosen.append(best)
        allowed &= _disjoint(rows, lattices, best)
        allowed[best] = False
        for block, weight in zip(blocks, weights, strict=True):
            weight[block[best]] *= REPEATED
    return np.asarray(order[chosen])
