"""A way to a goal: obstacles that block it for most, and a witness that gets by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smp_gym import kinematics
from smp_gym.sampling import kernels
from smp_gym.sampling.body import ObjectTask
from smp_gym.sampling.carrying import release_configuration
from smp_gym.sampling.choice import apart, choose
from smp_gym.sampling.conversion import to_configuration, to_row
from smp_gym.sampling.family import BLOCKING_DEPTH, PROPOSALS, Family, draw_family, member
from smp_gym.sampling.obstacles import draw_candidates, vary
from smp_gym.sampling.specification import DifficultySpecification
from smp_gym.sampling.witness import is_witness
from smp_gym.scene import Goal, ManipulatedObject, Scene, fixtures

__all__ = ["Draw", "draw_way"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


_DEFAULT_OBJECT = ManipulatedObject()

_FAMILIES = 3
_CANDIDATE_SETS = 2
_MAX_CHOICES = 8
"""How many families are tried for a goal, how many sets of candidates with a family, and how many
choices with a set."""

_GENERATIONS = 2
_PARENTS = 24
"""How many generations of candidates there are, and how many of one have children."""

_DEPTH = BLOCKING_DEPTH + 0.01
"""Metres: how deep an obstacle has to reach on the grid, whose guesses are the least of many and so
rather too near."""

_GLANCE = 8
"""Every so-many-th sample of another witness is looked at first."""


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
    for _ in range(_FAMILIES if crowd else 1):
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
    others = np.empty((0, kernels.OBSTACLE_COLUMNS)) if before is None else before.rows
    proposed = family.free[: family.proposals]
    already = family.near(others, -_DEPTH)[:, : family.proposals].sum(axis=0)
    able = family.able & ~family.near(others, specification.clearance).any(axis=0)
    rows, blocks, clears = _candidates(task, specification, goals, family, able, rng, before)
    bare = Scene(task="Placement", start=to_configuration(task.start), goals=goals)
    bodies = np.array([to_row(body) for body in fixtures(bare)])
    for _ in range(_MAX_CHOICES):
        choice = choose(rows, blocks, clears & able, already, specification)
        if choice is None:
            return None
        together = np.concatenate([others, rows[choice]])
        if choice:
            free = proposed & ~family.blocked(together)
            if free[0] or free.sum() > specification.free_share * proposed.sum():
                return None
        if before is not None and not all(
            _leaves_clear(task, before.witness, rows[choice], specification.clearance)
        ):
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


def _candidates(
    task: ObjectTask,
    specification: DifficultySpecification,
    goals: tuple[Goal, ...],
    family: Family,
    able: BoolArray,
    rng: np.random.Generator,
    before: Draw | None,
) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Return (C, 9) candidates, which proposals they block, and whom they leave clear."""
    rows = np.empty((0, kernels.OBSTACLE_COLUMNS))
    blocks = np.empty((0, family.proposals), np.bool_)
    clears = np.empty((0, len(able)), np.bool_)
    proposed = family.free[: family.proposals]
    for generation in range(_GENERATIONS if specification.obstacles else 0):
        if generation == 0:
            new = draw_candidates(task, family, goals, rng)
        else:
            most = np.argsort(-blocks.sum(axis=1), kind="stable")[:_PARENTS]
            new = vary(task, goals, rows[most], rng)
        if before is not None:
            glance = before.witness[::_GLANCE]
            new = new[_leaves_clear(task, glance, new, specification.clearance)]
            new = new[apart(new, before.rows).all(axis=1)]
        clear = ~family.near(new, specification.clearance)
        # Whoever stands in everybody's way, at the start or before the goal, is of no use.
        useful = (clear & able).any(axis=1)
        new, clear = new[useful], clear[useful]
        block = family.near(new, -_DEPTH)[:, : family.proposals] & proposed
        rows = np.concatenate([rows, new])
        blocks = np.concatenate([blocks, block])
        clears = np.concatenate([clears, clear])
        if not len(rows):
            break
    return rows, blocks, clears


def _leaves_clear(
    task: ObjectTask, trajectory: FloatArray, rows: FloatArray, clearance: float
) -> BoolArray:
    """Return which obstacles keep a clearance from a (T, 6) trajectory."""
    path, radius = task.paths(trajectory), task.spheres.radius
    clear: BoolArray = kernels.path_clearances(path, radius, rows, clearance) >= clearance
    return clear
