"""Candidate obstacles: near the trajectories of a family, off table, goals and start."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.sampling import kernels
from smp_gym.sampling.bodies import draw_bodies, shrunk, vary_bodies
from smp_gym.sampling.choice import widths
from smp_gym.sampling.conversion import to_solid_row
from smp_gym.sampling.family import Family
from smp_gym.sampling.transfer import Query

__all__ = [
    "BASE_DISTANCE",
    "START_CLEARANCE",
    "draw_candidates",
    "fits",
    "vary",
]


_HAND_LINK = 4
BASE_DISTANCE = 0.25
"""Obstacles stand before the hand: near spheres from this link on, and so far (m) from the axis of
the base. Nearer to it they would block more, but the shoulder, not the hand."""

START_CLEARANCE = 0.02
"""Obstacles: distance (m) to the robot at the start."""

_CANDIDATES = 300
"""Number of obstacles drawn to choose from."""

_SHRINKINGS = 3
"""Number of times that an obstacle that does not fit is made smaller."""

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
    return rows


def fitted(query: Query, rows: FloatArray, useful: Callable[[FloatArray], BoolArray]) -> FloatArray:
    """Return those of obstacles that fit and are useful, made smaller where that is needed.

    Args:
        query: which transfer to which goal.
        rows: (C, 9).
        useful: returns which of obstacles (C, 9) may be chosen.
    """
    done = []
    for _ in range(1 + _SHRINKINGS):
        good = fits(query, rows)
        good[good] = useful(rows[good])
        done.append(rows[good])
        rows = shrunk(rows[~good])
    return np.concatenate(done)


def vary(rows: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return rows of obstacles that resemble the given ones, but are shifted, turned and wider."""
    return vary_bodies(rows, _CHILDREN, rng)


def fits(query: Query, rows: FloatArray) -> BoolArray:
    """Return a mask (C,) of obstacles clear of base, table, goals and start."""
    fits: BoolArray = np.hypot(rows[:, 1], rows[:, 2]) >= BASE_DISTANCE
    fits &= rows[:, 3] >= rows[:, 8]
    width = widths(rows)
    transfer = query.transfer
    for goal in query.goals:
        aside = np.abs(rows[:, 1:3] - np.asarray(goal.position[:2])).max(axis=1)
        fits &= aside >= to_solid_row(goal)[6] + transfer.goal_clearance + width
    fits[fits] = transfer.at_start.clear(rows[fits], START_CLEARANCE)
    return fits
