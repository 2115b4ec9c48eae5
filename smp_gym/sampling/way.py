"""A way to a goal: obstacles that block it for most, and a witness that gets by."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smp_gym.robot import kinematics
from smp_gym.sampling import kernels
from smp_gym.sampling.body import ObjectTask
from smp_gym.sampling.candidates import Candidates
from smp_gym.sampling.carrying import release_configuration
from smp_gym.sampling.choice import apart, choose
from smp_gym.sampling.conversion import to_configuration, to_obstacle, to_row
from smp_gym.sampling.family import Family, draw_family, member
from smp_gym.sampling.obstacles import draw_candidates, vary
from smp_gym.sampling.specification import DifficultySpecification
from smp_gym.sampling.witness import is_witness
from smp_gym.scene import Goal, ManipulatedObject, Scene, fixtures

__all__ = ["MAX_CHOICES", "PARENTS", "ROUNDS", "Draw", "draw_way", "first_scene", "leaves_clear"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


_DEFAULT_OBJECT = ManipulatedObject()

_FAMILIES = 4
ROUNDS = 3
MAX_CHOICES = 12
"""How many families are tried for a goal, how often candidates are added for a family, and how many
choices are made from them each time."""

PARENTS = 24
"""How many of the candidates have children, others that resemble them."""

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


def first_scene(
    draw: Callable[[], Draw | None], attempts: int, **identity: Any
) -> tuple[Scene, FloatArray]:
    """Draw until goals, obstacles and a witness fit together; return scene and witness.

    Args:
        draw: draws once.
        attempts: how often at most.
        identity: fields of the `Scene` that say which it is: task, version, difficulty, seed.

    Raises:
        RuntimeError: nothing fitted together.
    """
    for _ in range(attempts):
        drawn = draw()
        if drawn is not None:
            scene = Scene(
                **identity,
                start=to_configuration(drawn.start),
                manipulated=drawn.manipulated,
                goals=drawn.goals,
                obstacles=tuple(to_obstacle(row) for row in drawn.rows),
            )
            return scene, drawn.witness
    raise RuntimeError(f"no solvable scene found for {identity}")


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
            task,
            goals,
            configuration,
            task.proposals if crowd else 0,
            task.wide if crowd else 0,
            rng,
        )
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
    already = family.blocked(others).sum(axis=0)
    able = family.able & ~family.near(others, specification.clearance).any(axis=0)
    most = int(specification.free_share * proposed.sum())
    bodies = _fixtures(task, goals)
    candidates = Candidates.none(family, len(able))
    free = proposed & (already == 0)
    for _ in range(ROUNDS if specification.obstacles else 1):
        if specification.obstacles:
            # What is left free after a choice shows where obstacles are missing.
            pool = draw_candidates(task, family, free, goals, rng)
            candidates = candidates.joined(_useful(task, specification, family, able, before, pool))
            pool = vary(task, goals, candidates.most_blocking(PARENTS), rng)
            candidates = candidates.joined(_useful(task, specification, family, able, before, pool))
        for _ in range(MAX_CHOICES):
            choice = choose(
                candidates.rows, candidates.blocks, candidates.clears & able, already, specification
            )
            if choice is None:
                break
            known = candidates.check(family, choice)
            free = proposed & (already == 0) & ~candidates.blocks[choice].any(axis=0)
            if choice and (free[0] or free.sum() > most):
                if known:
                    break
                continue
            rows = candidates.rows[choice]
            if (
                before is not None
                and not leaves_clear(task, before.witness, rows, specification.clearance).all()
            ):
                return None
            together = np.concatenate([others, rows])
            alive = able & candidates.clears[choice].all(axis=0)
            for index in np.flatnonzero(alive):
                witness = member(task, family, int(index))
                if is_witness(task, witness, bodies, together, specification.clearance):
                    return Draw(
                        task.start, goals, together, witness if before is None else before.witness
                    )
            able[alive] = False
    return None


def _fixtures(task: ObjectTask, goals: tuple[Goal, ...]) -> FloatArray:
    """Return the (F, 9) rows of table and goals."""
    bare = Scene(task="Placement", start=to_configuration(task.start), goals=goals)
    return np.array([to_row(body) for body in fixtures(bare)])


def _useful(
    task: ObjectTask,
    specification: DifficultySpecification,
    family: Family,
    able: BoolArray,
    before: Draw | None,
    rows: FloatArray,
) -> Candidates:
    """Return those of (C, 9) obstacles that leave somebody able and an earlier way clear."""
    if before is not None:
        glance = before.witness[::_GLANCE]
        rows = rows[leaves_clear(task, glance, rows, specification.clearance)]
        rows = rows[apart(rows, before.rows).all(axis=1)]
    clears = ~family.near(rows, specification.clearance)
    # What stands in everybody's way, at the start or before the goal, is of no use.
    useful = (clears & able).any(axis=1)
    rows, clears = rows[useful], clears[useful]
    return Candidates.guessed(family, rows, clears)


def leaves_clear(
    task: ObjectTask, trajectory: FloatArray, rows: FloatArray, clearance: float
) -> BoolArray:
    """Return which obstacles keep a clearance from a (T, 6) trajectory."""
    path, radius = task.paths(trajectory), task.spheres.radius
    clear: BoolArray = kernels.path_clearances(path, radius, rows, clearance) >= clearance
    return clear
