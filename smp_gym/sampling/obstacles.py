"""Obstacles: candidates near the ways of a family, and the choice of those that block most."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from smp_gym.sampling import kernels
from smp_gym.sampling.body import ObjectTask
from smp_gym.sampling.family import Family
from smp_gym.sampling.specification import DifficultySpecification
from smp_gym.scene import (
    BIN_INNER_HALF_WIDTH,
    BIN_WALL_THICKNESS,
    PAD_HALF_WIDTH,
    SHAPES,
    Goal,
    ManipulatedObject,
)

__all__ = [
    "BASE_DISTANCE",
    "HALF_EXTENTS",
    "PAIRED_CANDIDATES",
    "REPEATED",
    "SHAPE_SHARES",
    "START_CLEARANCE",
    "apart",
    "choose",
    "draw_candidates",
    "draw_rows",
]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


_HAND_LINK = 5
BASE_DISTANCE = 0.35
"""Obstacles stand in the way of the hand: near spheres from this link on, and so far (m) from the
axis of the base. Nearer to it they would block more, but the shoulder, not the way."""

START_CLEARANCE = 0.05
_GOAL_CLEARANCES = {"bin": 0.03, "pad": 0.01, "lift": 0.03}
_OVERLAP = 0.8
"""Obstacles: distance (m) to the robot at the start, sideways to bin or pad, and how near their
axes may come, as a share of the sum of their widths."""

_HALF_WIDTHS = {
    "bin": BIN_INNER_HALF_WIDTH + BIN_WALL_THICKNESS,
    "pad": PAD_HALF_WIDTH,
    "lift": max(ManipulatedObject().size),
}
"""m, of the bodies of goals, or of the object that is lifted to one."""

HALF_EXTENTS = (0.03, 0.06)
_TABLE_SHARE = 0.35
SHAPE_SHARES = (0.5, 0.3, 0.2)
"""Obstacles: range of half-extents (m), share that stands on the table, shares of `SHAPES`."""

_CANDIDATES = 1200
PAIRED_CANDIDATES = 200
REPEATED = 0.1
"""How many obstacles are drawn to choose from, how many of the most blocking are compared in pairs,
and what blocking a proposal counts for each obstacle that blocks it already."""


def widths(rows: FloatArray) -> FloatArray:
    """Return the (C,) horizontal radius of obstacles, m."""
    widths: FloatArray = np.where(
        rows[:, 0] == SHAPES.index("box"), np.hypot(rows[:, 6], rows[:, 7]), rows[:, 6]
    )
    return widths


def draw_rows(points: FloatArray, radius: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return (C, 9) rows of random obstacles that reach spheres about points, or stand below.

    Args:
        points: (C, 3) m.
        radius: (C,) m.
        rng: source of all randomness.
    """
    count = len(points)
    shape = rng.choice(len(SHAPES), size=count, p=SHAPE_SHARES)
    size = rng.uniform(*HALF_EXTENTS, size=(count, 3))
    box, ball = SHAPES.index("box"), SHAPES.index("sphere")
    size[shape != box, 1] = size[shape != box, 0]
    size[shape == ball, 2] = size[shape == ball, 0]
    yaw = rng.uniform(-np.pi, np.pi, size=count)
    offset = rng.standard_normal((count, 3))
    offset *= rng.uniform(size=(count, 1)) / np.sqrt((offset**2).sum(axis=1, keepdims=True))
    position = points + offset * (radius + size.min(axis=1))[:, None]
    on_table = rng.uniform(size=count) < _TABLE_SHARE
    position[:, 2] = np.where(on_table, size[:, 2], position[:, 2])
    return np.column_stack([shape, position, np.cos(yaw), np.sin(yaw), size])


def draw_candidates(
    task: ObjectTask, family: Family, goals: tuple[Goal, ...], rng: np.random.Generator
) -> FloatArray:
    """Return rows of obstacles near the paths of free proposals, off table, goals and start."""
    count = _CANDIDATES
    pool = np.flatnonzero(family.free[: family.proposals])
    if not len(pool):
        return np.empty((0, kernels.OBSTACLE_COLUMNS))
    member = pool[rng.integers(len(pool), size=count)]
    sample = rng.integers(task.samples, size=count)
    hand = np.flatnonzero(task.spheres.link[task.swept] >= _HAND_LINK)
    sphere = hand[rng.integers(len(hand), size=count)]
    rows = draw_rows(family.paths[member, sample, sphere], family.radius[sphere], rng)
    position, size = rows[:, 1:4], rows[:, 6:]
    fits = np.hypot(position[:, 0], position[:, 1]) >= BASE_DISTANCE
    fits &= position[:, 2] >= size[:, 2]
    for goal in goals:
        aside = np.abs(position[:, :2] - np.asarray(goal.position[:2])).max(axis=1)
        fits &= aside >= _HALF_WIDTHS[goal.kind] + _GOAL_CLEARANCES[goal.kind] + widths(rows)
    rows = rows[fits]
    start, radius = task.paths(task.start[None]), task.spheres.radius
    clear = kernels.path_clearances(start, radius, rows, 1.0) >= START_CLEARANCE
    if task.push is not None:
        path, radius = task.push.object_path, task.push.object_radius
        clear &= kernels.path_clearances(path, radius, rows, 1.0) >= _GOAL_CLEARANCES["lift"]
    return rows[clear]


def apart(rows: FloatArray, others: FloatArray) -> BoolArray:
    """Return (A, B), which obstacles stand beside or over which others."""
    reach = _OVERLAP * (widths(rows)[:, None] + widths(others))
    distance = np.hypot(rows[:, None, 1] - others[:, 1], rows[:, None, 2] - others[:, 2])
    height = np.abs(rows[:, None, 3] - others[:, 3])
    beside: BoolArray = (distance >= reach) | (height >= rows[:, None, 8] + others[:, 8])
    return beside


def choose(
    rows: FloatArray,
    blocks: BoolArray,
    clears: BoolArray,
    pairs: BoolArray,
    specification: DifficultySpecification,
) -> list[int] | None:
    """Choose obstacles that block most and leave somebody clear.

    The first two are the best of all pairs of the most blocking candidates; each further one adds
    most. A proposal that is blocked already still counts a little, so that its neighbours, which
    were not drawn, are blocked too.

    Args:
        rows: (C, 9) candidates, the most blocking first.
        blocks: (C, P), which proposals each blocks; proposal 0, the mean, must be blocked.
        clears: (C, N), from which possible witnesses each keeps its clearance.
        pairs: (S, S), which of the first S candidates may stand together.
        specification: how many to choose, and how many of more than two on the table.

    Returns:
        Indices of the chosen; None if nobody would be left clear.
    """
    count = specification.obstacles
    if count == 0:
        return []
    standing = rows[:, 3] == rows[:, 8]
    if count == 1:
        worth = np.where(blocks[:, 0] & clears.any(axis=1), blocks.sum(axis=1), 0)
        return [int(np.argmax(worth))] if worth.any() else None
    first, second = kernels.best_pair(
        kernels.packed(blocks[: len(pairs)]),
        kernels.packed(clears[: len(pairs)]),
        pairs,
    )
    if first < 0:
        return None
    chosen = [first, second]
    while len(chosen) < count:
        alive = clears[chosen].all(axis=0)
        weight = REPEATED ** blocks[chosen].sum(axis=0)
        allowed: BoolArray = np.any(clears & alive, axis=1)
        allowed[~apart(rows, rows[chosen]).all(axis=1)] = False
        if len(chosen) >= count - specification.on_table:
            allowed[~standing] = False
        worth = np.where(allowed, (blocks * weight).sum(axis=1), -1.0)
        best = int(np.argmax(worth))
        if worth[best] < 0:
            return None
        chosen.append(best)
    return chosen
