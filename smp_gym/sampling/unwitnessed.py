"""Scenes placed without a witness: whether they can be solved is for others to find out.

A scene with a witness favours planners that look where witnesses are looked for. Here goal, family
and candidates are drawn as in `smp_gym.sampling.scenes`, and obstacles are chosen to block the mean
and as many proposals as they can; they keep clear of the configurations that all proposals share,
their begin and end and a push between, but of nothing else. So some of these scenes cannot be
solved; `scripts/make_benchmark.py` certifies those that can.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from smp_gym.robot import kinematics
from smp_gym.sampling import kernels, strokes
from smp_gym.sampling.body import ObjectTask
from smp_gym.sampling.candidates import Candidates
from smp_gym.sampling.carrying import carry, release_configuration
from smp_gym.sampling.choice import apart, choose
from smp_gym.sampling.conversion import to_configuration, to_obstacle
from smp_gym.sampling.family import draw_family
from smp_gym.sampling.obstacles import START_CLEARANCE, draw_candidates, vary
from smp_gym.sampling.placing import (
    double_sided_tasks,
    draw_bin,
    draw_pads,
    placement_task,
    side_specifications,
    stopper,
)
from smp_gym.sampling.push_lift import draw_lift, lift_specification
from smp_gym.sampling.specification import SPECIFICATIONS, DifficultySpecification, generator
from smp_gym.sampling.way import MAX_CHOICES, PARENTS, ROUNDS
from smp_gym.sampling.witness import WITNESS_SAMPLES
from smp_gym.scene import DIFFICULTIES, TASKS, Goal, ManipulatedObject, Scene

__all__ = ["place_without_witness"]

FloatArray = NDArray[np.float64]

_MAX_DRAWS = 200
_NO_ROWS = np.empty((0, kernels.OBSTACLE_COLUMNS))


def _shared(task: ObjectTask, configuration: FloatArray) -> FloatArray:
    """Return (T, S, 3) m, the spheres where all ways lead: to the goal, and along the push."""
    phase = np.linspace(0.0, 1.0, WITNESS_SAMPLES)
    kept = phase == 1.0
    if task.push is not None:
        begin, end = task.push.phases
        kept |= (phase >= begin) & (phase <= end)
    way = carry(task, configuration, WITNESS_SAMPLES).mean(axis=0)
    return np.ascontiguousarray(task.paths(way)[kept])


def _block(
    task: ObjectTask,
    specification: DifficultySpecification,
    goal: Goal,
    goals: tuple[Goal, ...],
    rng: np.random.Generator,
    others: FloatArray = _NO_ROWS,
) -> FloatArray | None:
    """Return (M, 9) rows that block the mean and enough of the proposals, and the others.

    None if nothing blocks enough.
    """
    try:
        configuration = release_configuration(task, goal)
    except kinematics.UnreachableError:
        return None
    family = draw_family(task, goals, configuration, task.proposals, 0, rng)
    proposed = family.free[: family.proposals]
    most = int(specification.free_share * proposed.sum())
    already = family.blocked(others).sum(axis=0)
    shared, radius = _shared(task, configuration), task.spheres.radius

    def useful(rows: FloatArray) -> Candidates:
        clear = kernels.path_clearances(shared, radius, rows, START_CLEARANCE) >= START_CLEARANCE
        rows = rows[clear & apart(rows, others).all(axis=1)]
        # One possible witness that nothing comes near.
        return Candidates.guessed(family, rows, np.ones((len(rows), 1), np.bool_))

    candidates = Candidates.none(family, 1)
    free = proposed & (already == 0)
    for _ in range(ROUNDS):
        candidates = candidates.joined(useful(draw_candidates(task, family, free, goals, rng)))
        parents = candidates.most_blocking(PARENTS)
        candidates = candidates.joined(useful(vary(task, goals, parents, rng)))
        for _ in range(MAX_CHOICES):
            choice = choose(
                candidates.rows, candidates.blocks, candidates.clears, already, specification
            )
            if choice is None:
                break
            known = candidates.check(family, choice)
            free = proposed & (already == 0) & ~candidates.blocks[choice].any(axis=0)
            if not free[0] and free.sum() <= most:
                return np.concatenate([others, candidates.rows[choice]])
            if known:
                break
    return None


_Placed = tuple[FloatArray, tuple[Goal, ...], FloatArray, ManipulatedObject]
"""(6,) start, goals, (M, 9) rows of obstacles, the object."""


def _place_placement(difficulty: str, rng: np.random.Generator) -> _Placed | None:
    task, goal = placement_task(), draw_bin(rng)
    rows = _block(task, SPECIFICATIONS[difficulty], goal, (goal,), rng)
    return None if rows is None else (task.start, (goal,), rows, ManipulatedObject())


def _place_double_sided(difficulty: str, rng: np.random.Generator) -> _Placed | None:
    tasks, goals = double_sided_tasks(), draw_pads(rng)
    side = int(rng.integers(2))
    one, other = side_specifications(difficulty)
    rows = _block(tasks[side], one, goals[side], goals, rng)
    if rows is None:
        return None
    if other is None:
        rows = np.concatenate([rows, stopper(goals[1 - side], rng)])
    else:
        rows = _block(tasks[1 - side], other, goals[1 - side], goals, rng, rows)
    return None if rows is None else (tasks[side].start, goals, rows, ManipulatedObject())


def _place_push_lift(difficulty: str, rng: np.random.Generator) -> _Placed | None:
    lift = draw_lift(rng)
    if lift is None:
        return None
    task, box, goal = lift
    rows = _block(task, lift_specification(difficulty), goal, (goal,), rng)
    return None if rows is None else (task.start, (goal,), rows, box)


_PLACE: dict[str, Callable[[str, np.random.Generator], _Placed | None]] = {
    "Placement": _place_placement,
    "DoubleSidedPlacement": _place_double_sided,
    "PushLiftBox": _place_push_lift,
}


def place_without_witness(task: str, difficulty: str, seed: int, version: int = 0) -> Scene:
    """Return the scene of (task, version, difficulty, seed) that is placed without a witness.

    Args:
        task: name of the task, one of `smp_gym.scene.TASKS`.
        difficulty: one of `smp_gym.scene.DIFFICULTIES` but "none", which has nothing to place.
        seed: not negative.
        version: version of the task's scene distribution.

    Returns:
        The scene. Its own `seed` is None, since `sample_scene` would draw another one from it.

    Raises:
        ValueError: no such task or difficulty, or a negative seed or version.
    """
    if task not in TASKS:
        raise ValueError(f"task must be one of {', '.join(TASKS)}; got {task!r}")
    crowded = [name for name in DIFFICULTIES if SPECIFICATIONS[name].obstacles]
    if difficulty not in crowded:
        raise ValueError(f"difficulty must be one of {', '.join(crowded)}; got {difficulty!r}")
    if seed < 0 or version < 0:
        raise ValueError(f"seed and version must not be negative, got {seed} and {version}")
    rng = generator(task, f"{difficulty}/without a witness", seed, version)
    if task == "DrawS":
        specification = SPECIFICATIONS[difficulty]
        return strokes.place_without_witness(specification, rng, difficulty, seed, version)
    for _ in range(_MAX_DRAWS):
        placed = _PLACE[task](difficulty, rng)
        if placed is not None:
            start, goals, rows, manipulated = placed
            return Scene(
                task=task,
                version=version,
                difficulty=difficulty,  # type: ignore[arg-type]
                start=to_configuration(start),
                manipulated=manipulated,
                goals=goals,
                obstacles=tuple(to_obstacle(row) for row in rows),
            )
    raise RuntimeError(f"no obstacles block enough in {task}, {difficulty}, seed {seed}")
