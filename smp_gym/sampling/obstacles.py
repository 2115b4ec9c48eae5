"""Candidate obstacles: near the trajectories of a family, off table, goals and start."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.sampling import kernels
from smp_gym.sampling.bodies import draw_bodies, vary_bodies
from smp_gym.sampling.choice import widths
from smp_gym.sampling.conversion import to_solid_row
from smp_gym.sampling.family import Family
from smp_gym.sampling.transfer import Query
from smp_gym.scene import SHAPES

__all__ = [
    "BASE_DISTANCE",
    "HALF_EXTENTS",
    "SHAPE_SHARES",
    "START_CLEARANCE",
    "draw_candidates",
    "draw_rows",
    "fits",
    "vary",
]


_HAND_LINK = 4
BASE_DISTANCE = 0.25
"""Obstacles stand before the hand: near spheres from this link on, and so far (m) from the axis of
the base. Nearer to it they would block more, but the shoulder, not the hand."""

START_CLEARANCE = 0.02
"""Obstacles: distance (m) to the robot at the start."""

HALF_EXTENTS = (0.03, 0.06)
_TABLE_SHARE = 0.35
SHAPE_SHARES = (0.5, 0.3, 0.2)
"""Obstacles: range of half-extents (m), share that stands on the table, shares of `SHAPES`."""

_CANDIDATES = 300
"""Number of obstacles drawn to choose from."""

_CHILDREN = 150
"""Number of children of the obstacles that block most."""


def draw_candidates(
    query: Query, family: Family, which: BoolArray, rng: np.random.Generator
) -> FloatArray:
    """Return rows of obstacles near the paths of members (N,), off table, goals and start."""
    transfer, count = query.transfer, _CANDIDATES
    pool = np.flatnonzero(which)
    if not len(pool):
        return np.empty((0, kernels.OBSTACLE_COLUMNS))
    member = pool[rng.integers(len(pool), size=count)]
    # More of them near the ends, where all trajectories meet (an arcsine distribution).
    phase = np.sin(rng.uniform(0.0, np.pi / 2.0, size=count)) ** 2
    sample = np.rint(phase * (transfer.samples - 1)).astype(np.int64)
    hand = np.flatnonzero(transfer.spheres.link[transfer.swept] >= _HAND_LINK)
    sphere = hand[rng.integers(len(hand), size=count)]
    rows = draw_bodies(family.paths[member, sample, sphere], family.radius[sphere], rng)
    return rows[fits(query, rows)]


def draw_rows(
    points: FloatArray, radius: FloatArray, skew: float, rng: np.random.Generator
) -> FloatArray:
    """Return (C, 9) rows of random obstacles that reach spheres, or stand on the table below.

    Args:
        points: (C, 3) m, centres of the spheres.
        radius: (C,) m.
        skew: 1 draws all half-extents alike, more draws more of the large ones.
        rng: source of all randomness.
    """
    count = len(points)
    shape = rng.choice(len(SHAPE_SHARES), size=count, p=SHAPE_SHARES)
    low, high = HALF_EXTENTS
    size = _sizes(shape, high - (high - low) * rng.uniform(size=(count, 3)) ** skew)
    yaw = rng.uniform(-np.pi, np.pi, size=count)
    offset = rng.standard_normal((count, 3))
    offset *= rng.uniform(size=(count, 1)) / np.sqrt((offset**2).sum(axis=1, keepdims=True))
    position = points + offset * (radius + size.min(axis=1))[:, None]
    on_table = rng.uniform(size=count) < _TABLE_SHARE
    position[:, 2] = np.where(on_table, size[:, 2], position[:, 2])
    return np.column_stack([shape, position, np.cos(yaw), np.sin(yaw), size])


def vary(query: Query, rows: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return rows of obstacles that resemble the given ones, but are shifted, turned and wider."""
    children = vary_bodies(rows, _CHILDREN, rng)
    return children[fits(query, children)]


def _sizes(shape: NDArray[Any], size: FloatArray) -> FloatArray:
    """Return (C, 3) half-extents, made those of (C,) shapes."""
    box, ball = SHAPES.index("box"), SHAPES.index("sphere")
    size[shape != box, 1] = size[shape != box, 0]
    size[shape == ball, 2] = size[shape == ball, 0]
    return size


def fits(query: Query, rows: FloatArray) -> BoolArray:
    """Return a mask (C,) of obstacles clear of base, table, goals and start."""
    fits: BoolArray = np.hypot(rows[:, 1], rows[:, 2]) >= BASE_DISTANCE
    fits &= rows[:, 3] >= rows[:, 8]
    width = widths(rows)
    transfer = query.transfer
    for goal in query.goals:
        aside = np.abs(rows[:, 1:3] - np.asarray(goal.position[:2])).max(axis=1)
        fits &= aside >= to_solid_row(goal)[6] + transfer.goal_clearance + width
    start = transfer.start[None]
    fits &= transfer.clearances(start, rows, START_CLEARANCE) >= START_CLEARANCE
    return fits
