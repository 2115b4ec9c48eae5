"""A way to a goal: obstacles that block it for most, and a witness that gets by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smp_gym import kinematics
from smp_gym.sampling import kernels
from smp_gym.sampling.body import ObjectTask
from smp_gym.sampling.carrying import release_configuration
from smp_gym.sampling.conversion import to_configuration, to_row
from smp_gym.sampling.family import BLOCKING_DEPTH, PROPOSALS, Family, draw_family, member
from smp_gym.sampling.grid import GRID_SLACK
from smp_gym.sampling.obstacles import PAIRED_CANDIDATES, apart, choose, draw_candidates
from smp_gym.sampling.specification import DifficultySpecification
from smp_gym.sampling.witness import is_witness
from smp_gym.scene import Goal, ManipulatedObject, Scene, fixtures

__all__ = ["Draw", "draw_way"]

FloatArray = NDArray[np.float64]


_DEFAULT_OBJECT = ManipulatedObject()

_CANDIDATE_SETS = 2
_MAX_CHOICES = 8
"""How many sets of candidates are tried with a family, and how many choices with a set."""


@dataclass(frozen=True, eq=False)
class Draw:
    """One draw: (6,) start, goals, (M, 9) rows of obstacles, (W, 6) witness, the object."""

    start: FloatArray
    goals: tuple[Goal, ...]
    rows: FloatArray
    witness: FloatArray
    manipulated: ManipulatedObject = _DEFAULT_OBJECT


def draw_way(
    task: ObjectTask,
    specification: DifficultySpecification,
    goal: Goal,
    goals: tuple[Goal, ...],
    rng: np.random.Generator,
    before: Draw | None = None,
) -> Draw | None:
    """Draw obstacles on the way to a goal, and a witness; None if they do not fit together.

    Args:
        task: whose way it is.
        specification: of these obstacles.
        goal: where the way leads.
        goals: all of the scene.
        rng: source of all randomness.
        before: a way that was drawn before: its witness stays one, and its obstacles are in the
            result, too.
    """
    try:
        configuration = release_configuration(task, goal)
    except kinematics.UnreachableError:
        return None
    crowd = specification.obstacles > 0
    family = draw_family(
        task, goals, configuration, PROPOSALS if crowd else 0, task.wide if crowd else 0, rng
    )
    for _ in range(_CANDIDATE_SETS if crowd else 1):
        drawn = _place(task, specification, goals, family, rng, before)
        if drawn is not None:
            return drawn
    return None


def _place(
    task: ObjectTask,
    specification: DifficultySpecification,
    goals: tuple[Goal, ...],
    family: Family,
    rng: np.random.Generator,
    before: Draw | None = None,
) -> Draw | None:
    """Draw obstacles for a family and find its witness; None if too much is free or nothing."""
    count = specification.obstacles
    rows = np.empty((0, kernels.OBSTACLE_COLUMNS))
    if count:
        rows = draw_candidates(task, family, goals, rng)
    proposed = family.free[: family.proposals]
    able = family.able.copy()
    others = rows[:0]
    if before is not None:
        others = before.rows
        path, radius = task.paths(before.witness), task.spheres.radius
        enough = specification.clearance
        kept = kernels.path_clearances(path, radius, rows, enough) >= enough
        rows = rows[kept & apart(rows, others).all(axis=1)]
        able &= ~family.near(others, specification.clearance + GRID_SLACK).any(axis=0)
    blocks = family.near(rows, -BLOCKING_DEPTH)[:, : family.proposals] & proposed
    order = np.argsort(-blocks.sum(axis=1), kind="stable")
    rows, blocks = rows[order], blocks[order]
    pairs = apart(rows[:PAIRED_CANDIDATES], rows[:PAIRED_CANDIDATES])
    clears = ~family.near(rows, specification.clearance + GRID_SLACK)
    bare = Scene(task="Placement", start=to_configuration(task.start), goals=goals)
    bodies = np.array([to_row(body) for body in fixtures(bare)])
    for _ in range(_MAX_CHOICES):
        choice = choose(rows, blocks, clears & able, pairs, specification)
        if choice is None:
            return None
        together = np.concatenate([others, rows[choice]])
        free = proposed & ~family.blocked(together)
        if count and (free[0] or free.sum() > specification.free_share * proposed.sum()):
            return None
        alive = able & clears[choice].all(axis=0)
        for index in np.flatnonzero(alive):
            witness = member(task, family, int(index))
            if is_witness(task, witness, bodies, together, specification.clearance):
                return Draw(
                    task.start, goals, together, witness if before is None else before.witness
                )
        able[alive] = False
    return None
