"""Scenes placed without a witness: whether they can be solved is for others to find out.

A scene with a witness favours planners that look where witnesses are looked for. Here goal, family
and candidates are drawn as in `smp_gym.sampling.scenes`, and obstacles are chosen to block the mean
and as many proposals as they can; they keep clear of the configurations in which the proposals
begin and end, but of nothing in between. So some of these scenes cannot
be solved; `scripts/make_benchmark.py` certifies those that can.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from smp_gym import kinematics
from smp_gym.sampling import kernels
from smp_gym.sampling.body import ObjectTask
from smp_gym.sampling.carrying import release_configuration
from smp_gym.sampling.choice import choose
from smp_gym.sampling.conversion import to_configuration, to_obstacle
from smp_gym.sampling.family import BLOCKING_DEPTH, PROPOSALS, Family, draw_family
from smp_gym.sampling.obstacles import (
    START_CLEARANCE,
    draw_candidates,
)
from smp_gym.sampling.placing import draw_bin, placement_task
from smp_gym.sampling.specification import SPECIFICATIONS, DifficultySpecification, generator
from smp_gym.scene import DIFFICULTIES, Goal, ManipulatedObject, Scene

__all__ = ["place_without_witness"]

FloatArray = NDArray[np.float64]

_MAX_DRAWS = 60

_TASKS = ("Placement",)
"""Tasks whose scenes can be placed so."""


def _choose_obstacles(
    task: ObjectTask,
    specification: DifficultySpecification,
    goal: Goal,
    family: Family,
    rng: np.random.Generator,
) -> FloatArray | None:
    """Return (M, 9) rows that block the mean and enough of the proposals; None if none do."""
    proposed = family.free[: family.proposals]
    rows = draw_candidates(task, family, (goal,), rng)
    # Every proposal ends over the goal: without this, that is where the obstacles would gather.
    end, radius = task.paths(family.configuration[None]), task.spheres.radius
    clearance = kernels.path_clearances(end, radius, rows, 1.0)
    rows = rows[clearance >= START_CLEARANCE]
    depth = -BLOCKING_DEPTH
    blocks = family.near(rows, depth)[:, : family.proposals] & proposed
    # One possible witness that nothing comes near.
    clears = np.ones((len(rows), 1), np.bool_)
    already = np.zeros(family.proposals, np.int64)
    choice = choose(rows, blocks, clears, already, specification)
    if choice is None:
        return None
    free = proposed & ~family.blocked(rows[choice])
    if free[0] or free.sum() > specification.free_share * proposed.sum():
        return None
    chosen: FloatArray = rows[choice]
    return chosen


def place_without_witness(task: str, difficulty: str, seed: int, version: int = 0) -> Scene:
    """Return the scene of (task, version, difficulty, seed) that is placed without a witness.

    Args:
        task: name of the task: "Placement".
        difficulty: one of `smp_gym.scene.DIFFICULTIES` but "none", which has nothing to place.
        seed: not negative.
        version: version of the task's scene distribution.

    Returns:
        The scene. Its own `seed` is None, since `sample_scene` would draw another one from it.

    Raises:
        ValueError: no such task or difficulty, or a negative seed or version.
    """
    if task not in _TASKS:
        raise ValueError(f"task must be one of {', '.join(_TASKS)}; got {task!r}")
    crowded = [name for name in DIFFICULTIES if SPECIFICATIONS[name].obstacles]
    if difficulty not in crowded:
        raise ValueError(f"difficulty must be one of {', '.join(crowded)}; got {difficulty!r}")
    if seed < 0 or version < 0:
        raise ValueError(f"seed and version must not be negative, got {seed} and {version}")
    specification = SPECIFICATIONS[difficulty]
    rng = generator(task, f"{difficulty}/without a witness", seed, version)
    data = placement_task()
    for _ in range(_MAX_DRAWS):
        goal = draw_bin(rng)
        try:
            configuration = release_configuration(data, goal)
        except kinematics.UnreachableError:
            continue
        family = draw_family(data, (goal,), configuration, PROPOSALS, data.wide, rng)
        rows = _choose_obstacles(data, specification, goal, family, rng)
        if rows is not None:
            return Scene(
                task=task,
                version=version,
                difficulty=difficulty,  # type: ignore[arg-type]
                start=to_configuration(data.start),
                manipulated=ManipulatedObject(),
                goals=(goal,),
                obstacles=tuple(to_obstacle(row) for row in rows),
            )
    raise RuntimeError(f"no obstacles block enough in {task}, {difficulty}, seed {seed}")
