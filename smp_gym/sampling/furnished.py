"""Furnished scenes: (task, version, kind of furniture, seed) -> `Scene`, solvable by construction.

Furniture cannot be put together around a witness as single obstacles are. So pieces of it are drawn
until one blocks the mean of the demonstrations and most of what a primitive would propose, and
still leaves a member of the family clear; that member, checked densely, is the witness. The two
ways of DoubleSidedPlacement are both furnished, and both have a witness.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from smp_gym.robot import kinematics
from smp_gym.sampling import kernels
from smp_gym.sampling.body import ObjectTask
from smp_gym.sampling.carrying import release_configuration
from smp_gym.sampling.conversion import to_configuration, to_row, to_solid_row
from smp_gym.sampling.family import BLOCKING_DEPTH, Family, draw_family, member
from smp_gym.sampling.furniture import FURNITURE, Place, draw_furniture
from smp_gym.sampling.obstacles import START_CLEARANCE
from smp_gym.sampling.placing import double_sided_tasks, draw_bin, draw_pads, placement_task
from smp_gym.sampling.scenes import sample_scene
from smp_gym.sampling.specification import generator
from smp_gym.sampling.way import Draw, first_scene
from smp_gym.sampling.witness import is_witness
from smp_gym.scene import FAMILIES, FURNISHED_TASKS, Goal, Scene, fixtures

__all__ = ["sample_furniture", "sample_furniture_with_witness", "sample_of_family"]

FloatArray = NDArray[np.float64]

_CLEARANCE = 0.02
"""m, what furniture leaves between itself and the witness's spheres."""

_GOAL_CLEARANCE = 0.012
"""m, between furniture and points on the body of a goal."""

_FREE_SHARE = 0.03
_FIRST_PROPOSALS = ((10, 0.10), (30, 0.07))
"""Share of the proposals that furniture may leave free, and larger ones that it may leave of the
first so many: most pieces are thrown away for these few."""

_SAMPLES = 40
_WIDE = 168
"""Samples of each member of a family, more than for single obstacles since furniture is thin, and
how many wide detours are drawn."""

_PIECES = 40
_MEMBERS = 20
_WAY_DRAWS = 6
_MAX_DRAWS = 400
"""How many pieces are tried with a family, how many of its members as the witness of each, how many
families on the second of two ways, and how many goals in all."""

_POINTS = (9, 9, 7)
"""Points on a goal's body along x, y and z that furniture is kept away from."""


def _points_of(goals: tuple[Goal, ...]) -> FloatArray:
    """Return (1, N, 3) m, points all over the bodies of goals."""
    points = []
    for goal in goals:
        row = np.array(to_solid_row(goal))
        steps = (np.linspace(-1.0, 1.0, count) for count in _POINTS)
        grid = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 3)
        points.append(row[1:4] + grid * row[6:9])
    return np.concatenate(points)[None]


def _blocks_enough(family: Family, rows: FloatArray) -> bool:
    """Return whether furniture blocks the mean and leaves few proposals free."""
    for count, share in (*_FIRST_PROPOSALS, (family.proposals, _FREE_SHARE)):
        paths = family.paths[:count]
        blocked = kernels.blocked_paths(paths, family.radius, rows, BLOCKING_DEPTH)
        free = family.free[:count] & ~blocked.any(axis=0)
        if free[0] or free.sum() > share * family.free[:count].sum():
            return False
    return True


def _draw_way(
    kind: str,
    task: ObjectTask,
    goal: Goal,
    goals: tuple[Goal, ...],
    rng: np.random.Generator,
    before: Draw | None = None,
) -> Draw | None:
    """Draw furniture on the way to a goal, and a witness; None if they do not fit together.

    Args:
        kind: of the furniture.
        task: whose way it is.
        goal: where the way leads.
        goals: all of the scene.
        rng: source of all randomness.
        before: a way that was drawn before: its witness stays one, and its furniture is in the
            result, too.
    """
    try:
        configuration = release_configuration(task, goal)
    except kinematics.UnreachableError:
        return None
    task = replace(task, samples=_SAMPLES)
    family = draw_family(task, goals, configuration, task.proposals, _WIDE, rng)
    radius = task.spheres.radius
    ends, points = task.paths(np.stack([task.start, configuration])), _points_of(goals)
    x, y, z = (kinematics.end_effector_pose(task.start) @ task.held)[:3, 3].tolist()
    place = Place(goal.position, (x, y, z))
    others = np.empty((0, kernels.OBSTACLE_COLUMNS)) if before is None else before.rows
    able = family.able & ~family.near(others, _CLEARANCE).any(axis=0)
    bare = Scene(task="Placement", start=to_configuration(task.start), goals=goals)
    bodies = np.array([to_row(body) for body in fixtures(bare)])

    def clearance(path: FloatArray, rows: FloatArray) -> float:
        return float(kernels.path_clearances(path, radius, rows, 1.0).min())

    for _ in range(_PIECES):
        rows = np.array([to_row(part) for part in draw_furniture(kind, place, rng)])
        at_goals = kernels.path_clearances(points, np.zeros(points.shape[1]), rows, 1.0).min()
        if (
            clearance(ends[:1], rows) < START_CLEARANCE
            or clearance(ends[1:], rows) < _CLEARANCE
            or at_goals < _GOAL_CLEARANCE
            or (before is not None and clearance(task.paths(before.witness), rows) < _CLEARANCE)
        ):
            continue
        alive = np.flatnonzero(able & ~family.near(rows, _CLEARANCE).any(axis=0))
        if not len(alive) or not _blocks_enough(family, rows):
            continue
        together = np.concatenate([others, rows])
        for index in alive[:_MEMBERS]:
            witness = member(task, family, int(index))
            if is_witness(task, witness, bodies, together, _CLEARANCE):
                chosen = witness if before is None else before.witness
                return Draw(task.start, goals, together, chosen)
    return None


def _draw_placement(kind: str, rng: np.random.Generator) -> Draw | None:
    goal = draw_bin(rng)
    return _draw_way(kind, placement_task(), goal, (goal,), rng)


def _draw_double_sided(kind: str, rng: np.random.Generator) -> Draw | None:
    """Draw furniture on both sides; the witness goes to one that is drawn at random."""
    goals = draw_pads(rng)
    tasks = double_sided_tasks()
    side = int(rng.integers(2))
    drawn = _draw_way(kind, tasks[side], goals[side], goals, rng)
    if drawn is None:
        return None
    for _ in range(_WAY_DRAWS):
        both = _draw_way(kind, tasks[1 - side], goals[1 - side], goals, rng, drawn)
        if both is not None:
            return both
    return None


_DRAWS: dict[str, Callable[[str, np.random.Generator], Draw | None]] = {
    "Placement": _draw_placement,
    "DoubleSidedPlacement": _draw_double_sided,
}
assert tuple(_DRAWS) == FURNISHED_TASKS


def sample_furniture_with_witness(
    task: str, kind: str, seed: int, version: int = 0
) -> tuple[Scene, FloatArray]:
    """Return a furnished scene and a trajectory that solves it.

    Args:
        task: one of `smp_gym.scene.FURNISHED_TASKS`.
        kind: of the furniture: "shelf", "box", "cage" or "table".
        seed: not negative; below `smp_gym.scene.EVALUATION_SEEDS_START` for tuning, from there on
            for evaluation.
        version: version of the task's scene distribution.

    Returns:
        The scene, of family `kind`, and the witness (200, 6) in rad as that of
        `smp_gym.sampling.sample_with_witness`.

    Raises:
        ValueError: no such task or kind, or a negative seed or version.
    """
    if task not in FURNISHED_TASKS:
        raise ValueError(
            f"task must be one of {', '.join(FURNISHED_TASKS)} to be furnished; got {task!r}"
        )
    if kind not in FURNITURE:
        raise ValueError(f"kind must be one of {', '.join(FURNITURE)}; got {kind!r}")
    if seed < 0 or version < 0:
        raise ValueError(f"seed and version must not be negative, got {seed} and {version}")
    rng = generator(task, f"furniture/{kind}", seed, version)
    draw = partial(_DRAWS[task], kind, rng)
    return first_scene(draw, _MAX_DRAWS, task=task, version=version, family=kind, seed=seed)


def sample_furniture(task: str, kind: str, seed: int, version: int = 0) -> Scene:
    """Return the furnished scene of (task, version, kind, seed), a pure function of these.

    Args:
        task: one of `smp_gym.scene.FURNISHED_TASKS`.
        kind: of the furniture: "shelf", "box", "cage" or "table".
        seed: not negative.
        version: version of the task's scene distribution.

    Raises:
        ValueError: no such task or kind, or a negative seed or version.
    """
    return sample_furniture_with_witness(task, kind, seed, version)[0]


def sample_of_family(task: str, family: str, difficulty: str, seed: int) -> Scene:
    """Return what an environment of this task, family and difficulty plays with this seed.

    Args:
        task: name of the task.
        family: one of `smp_gym.scene.FAMILIES`.
        difficulty: one of `smp_gym.scene.DIFFICULTIES`; furniture has none and disregards it.
        seed: not negative.

    Raises:
        ValueError: no such task, family or difficulty, a task without furniture, or a negative
            seed.
    """
    if family == FAMILIES[0]:
        return sample_scene(task, difficulty, seed)
    return sample_furniture(task, family, seed)
