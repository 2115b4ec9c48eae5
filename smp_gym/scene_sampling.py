"""Scene sampling: (task, version, difficulty, seed) -> `Scene`, solvable by construction.

A scene is drawn in four steps. The *goal* is drawn and a configuration above it is solved for. The
*family* of the task, the demonstrations carried to that goal plus smooth random detours, is drawn
from: these are the trajectories that a primitive fitted to the demonstrations would propose. One of
them, free of table, bin and itself and quick enough, becomes the *witness*. *Obstacles* are then
chosen greedily, each the one of many random candidates that blocks most of what is still free of the
family while it leaves the witness its clearance. So the witness solves the scene, the
demonstrations' mean does not, and few unadapted trajectories do.

No planner and no physics engine takes part. The witness is not part of the scene.
"""

from __future__ import annotations

import functools
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smp_gym import kinematics, sampling_kernels
from smp_gym.demonstrations import Demonstrations
from smp_gym.scene import (
    BIN_HEIGHT,
    BIN_INNER_HALF_WIDTH,
    BIN_WALL_THICKNESS,
    DIFFICULTIES,
    SHAPES,
    TASKS,
    Goal,
    ManipulatedObject,
    Obstacle,
    Scene,
    fixtures,
)
from smp_gym.tasks import placement

__all__ = ["SPECIFICATIONS", "DifficultySpecification", "sample_scene", "sample_with_witness"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class DifficultySpecification:
    """What a difficulty means.

    Attributes:
        obstacles: how many.
        clearance: m, what every obstacle leaves between itself and the witness's spheres.
        free_share: share of the family that may stay free before another witness is tried.
    """

    obstacles: int
    clearance: float
    free_share: float


SPECIFICATIONS = {
    "none": DifficultySpecification(obstacles=0, clearance=0.0, free_share=1.0),
    "easy": DifficultySpecification(obstacles=2, clearance=0.040, free_share=0.01),
    "medium": DifficultySpecification(obstacles=4, clearance=0.030, free_share=0.0),
    "hard": DifficultySpecification(obstacles=6, clearance=0.020, free_share=0.0),
}
"""Difficulties by name."""

_DETOUR_STD = 0.2
_DETOUR_LENGTH = 0.2
"""Standard deviation (rad) and length scale (phase) of the detours, those of the primitive's smooth
covariance: what it can propose is what has to be blocked."""

_FAMILY_SIZE = 128
_FAMILY_SAMPLES = 40
_WITNESS_SAMPLES = 200
_MAX_DURATION = 14.0
"""Seconds: longest witness, executed at constant speed of phase within the joint velocity limits."""

_FIXTURE_CLEARANCE = 0.010
_SELF_CLEARANCE = 0.005
_LIMIT_MARGIN = 0.05
"""Witness: distance (m) to table and bin, to itself, and (rad) to the joint limits."""

_START_CLEARANCE = 0.05
_GOAL_CLEARANCE = 0.03
"""Obstacles: distance (m) to the robot at the start, and sideways to the bin."""

_BLOCKING_DEPTH = 0.015
"""Metres: how deep an obstacle reaches into the covering spheres before a path counts as blocked.
The spheres stand out of the arm's shapes by about that much."""

_HALF_EXTENTS = (0.03, 0.06)
_CANDIDATES = 64
_TABLE_SHARE = 0.35
_SHAPE_SHARES = (0.5, 0.3, 0.2)
_MAX_WITNESSES = 12
_MAX_GOALS = 20


def _seed_sequence(task: str, difficulty: str, seed: int, version: int) -> np.random.SeedSequence:
    name = zlib.crc32(f"{task}/{difficulty}".encode())
    return np.random.SeedSequence([name, version, seed])


def _smoothstep(phase: FloatArray) -> FloatArray:
    """Minimum-jerk blend from 0 to 1 with velocity and acceleration zero at both ends."""
    return phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2)


@functools.lru_cache(maxsize=8)
def _detour_basis(samples: int) -> FloatArray:
    """Return (samples, F): a detour is this times F standard normal numbers, in units of its std.

    A stationary Gaussian process with squared-exponential kernel, written as a Fourier series of
    period 2 (twice the phase, so that its ends do not feel each other) and conditioned in closed
    form on value and velocity zero at both ends. No matrix factorisation is needed, so the result
    does not depend on the number of threads of a linear algebra library.
    """
    phase = np.linspace(0.0, 1.0, samples)
    harmonics = np.arange(0, 13)
    omega = np.pi * harmonics
    power = np.exp(-0.5 * (omega * _DETOUR_LENGTH) ** 2)
    power[1:] *= 2.0
    amplitude = np.sqrt(power / power.sum())

    def features(at: FloatArray) -> tuple[FloatArray, FloatArray]:
        angle = at[:, None] * omega
        value = np.concatenate([amplitude * np.cos(angle), amplitude * np.sin(angle)], axis=1)
        slope = np.concatenate(
            [-amplitude * omega * np.sin(angle), amplitude * omega * np.cos(angle)], axis=1
        )
        return value, slope

    ends = np.concatenate(features(np.array([0.0, 1.0])))
    value, _ = features(phase)
    gain = np.einsum("tf,cf->tc", value, ends)
    gram = np.einsum("cf,df->cd", ends, ends)
    correction = np.einsum("tc,cd,df->tf", gain, np.linalg.inv(gram), ends)
    basis: FloatArray = value - correction
    basis[[0, -1]] = 0.0
    return basis


def _detours(numbers: FloatArray, samples: int) -> FloatArray:
    """Return (N, samples, 6) rad from (N, F, 6) standard normal numbers."""
    return _DETOUR_STD * np.einsum("tf,nfj->ntj", _detour_basis(samples), numbers)


def _resample(trajectories: FloatArray, samples: int) -> FloatArray:
    """Return (N, samples, 6): (N, T, 6) at other equal steps of phase, linearly between samples."""
    at = np.linspace(0.0, trajectories.shape[1] - 1.0, samples)
    low = np.minimum(at.astype(np.int64), trajectories.shape[1] - 2)
    part = (at - low)[:, None]
    return trajectories[:, low] * (1.0 - part) + trajectories[:, low + 1] * part


def _duration(trajectory: FloatArray) -> float:
    """Return the shortest time of a (T, 6) trajectory at constant speed of phase, s."""
    rate = np.abs(np.diff(trajectory, axis=0)).max(axis=0) * (len(trajectory) - 1)
    return float((rate / kinematics.JOINT_VELOCITY).max())


@dataclass(frozen=True, eq=False)
class _Task:
    """What sampling needs to know of a task; built once per process.

    Attributes:
        demonstrations: (N, T, 6) rad.
        start: (6,) rad.
        spheres: arm, fingers and held object.
        moving: index of the spheres that the family is checked with.
        pairs: (P, 2) spheres that may not touch each other.
        release_rotation: (3, 3) orientation of the end effector at the demonstrations' mean end.
        release_height: m, of the object's centre over the goal there.
        nominal_goal: (3,) m, mean goal of the demonstrations.
    """

    demonstrations: FloatArray
    start: FloatArray
    spheres: kinematics.SphereSet
    moving: NDArray[np.int64]
    pairs: NDArray[np.int64]
    release_rotation: FloatArray
    release_height: float
    nominal_goal: FloatArray

    def paths(self, trajectories: FloatArray, which: NDArray[np.int64] | None = None) -> FloatArray:
        """Return (N, T, S, 3) m, centres of spheres (all, or the given) along trajectories."""
        link, center = self.spheres.link, self.spheres.center
        if which is not None:
            link, center = link[which], center[which]
        flat = np.ascontiguousarray(trajectories.reshape(-1, trajectories.shape[-1]))
        centers = sampling_kernels.sphere_paths(
            flat, kinematics.BASE_TRANSFORM, kinematics.JOINT_ORIGINS, link, center
        )
        return centers.reshape(*trajectories.shape[:-1], len(link), 3)


@functools.lru_cache(maxsize=1)
def _placement() -> _Task:
    demonstrations = Demonstrations.load("Placement")
    spheres = kinematics.concatenate(
        kinematics.arm_spheres(),
        kinematics.finger_spheres(np.asarray(placement.GRASP_FINGER_ANGLES)),
        kinematics.box_spheres(
            np.asarray(ManipulatedObject().size), np.asarray(placement.HELD_OBJECT_POSE)
        ),
    )
    end = demonstrations.mean[-1]
    pose = kinematics.end_effector_pose(end)
    held = pose @ np.asarray(placement.HELD_OBJECT_POSE)
    goals = np.array([scene.goals[0].position for scene in demonstrations.scenes])
    goal = goals.mean(axis=0)
    return _Task(
        demonstrations=demonstrations.configurations,
        start=np.asarray(placement.START_CONFIGURATION, np.float64),
        spheres=spheres,
        moving=np.flatnonzero(spheres.link >= 2),
        pairs=kinematics.self_collision_pairs(spheres),
        release_rotation=pose[:3, :3],
        release_height=float(held[2, 3] - goal[2]),
        nominal_goal=goal,
    )


def _draw_goal(task: _Task, rng: np.random.Generator) -> tuple[Goal, FloatArray]:
    """Return a goal of the task's range and a configuration (6,) that holds the object over it."""
    lower, upper = np.asarray(placement.BIN_LOWER), np.asarray(placement.BIN_UPPER)
    position = rng.uniform(lower, upper)
    goal = Goal(position=(float(position[0]), float(position[1]), float(position[2])))
    return goal, _release_configuration(task, goal)


def _release_configuration(task: _Task, goal: Goal) -> FloatArray:
    """Return the (6,) rad of the release over a goal: the demonstrated one, turned about the base.

    Raises:
        UnreachableError: the goal is out of reach.
    """
    position = np.asarray(goal.position)
    turn = np.arctan2(position[1], position[0]) - np.arctan2(
        task.nominal_goal[1], task.nominal_goal[0]
    )
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ task.release_rotation
    center = position + np.array([0.0, 0.0, task.release_height])
    held = np.asarray(placement.HELD_OBJECT_POSE)[:3, 3]
    seed = task.demonstrations[:, -1].mean(axis=0)
    seed[0] -= turn
    return kinematics.inverse_kinematics(center - rotation @ held, rotation, seed=seed)


def _carry(task: _Task, goal: FloatArray, samples: int) -> FloatArray:
    """Return the demonstrations, (N, samples, 6), blended to start and goal configuration."""
    carried = _resample(task.demonstrations, samples)
    blend = _smoothstep(np.linspace(0.0, 1.0, samples))[:, None]
    to_start = (task.start - carried[:, 0])[:, None]
    to_goal = (goal - carried[:, -1])[:, None]
    result: FloatArray = carried + (1.0 - blend) * to_start + blend * to_goal
    return result


@dataclass(frozen=True, eq=False)
class _Family:
    """Trajectories that a primitive of the demonstrations proposes for one goal.

    Member 0 is the mean of the carried demonstrations, then come these, then the detours.

    Attributes:
        carried: (N, W, 6) rad, the carried demonstrations at the witness's samples.
        numbers: (M, F, 6) standard normal numbers of the detours.
        base: (M,) which demonstration each detour belongs to.
        paths: (1 + N + M, T, S, 3) m, their moving spheres.
        radius: (S,) m.
        steps: (1 + N + M,) m, longest way of any sphere between two samples.
        free: (1 + N + M,) whether table and bin leave them free.
    """

    carried: FloatArray
    numbers: FloatArray
    base: NDArray[np.int64]
    paths: FloatArray
    radius: FloatArray
    steps: FloatArray
    free: NDArray[np.bool_]

    def member(self, index: int) -> FloatArray:
        """Return detour `index` at the witness's samples, (W, 6) rad."""
        detour = _detours(self.numbers[index : index + 1], self.carried.shape[1])[0]
        return self.carried[self.base[index]] + detour


def _draw_family(
    task: _Task, goal: FloatArray, bodies: FloatArray, rng: np.random.Generator
) -> _Family:
    features = _detour_basis(_FAMILY_SAMPLES).shape[1]
    base = rng.integers(len(task.demonstrations), size=_FAMILY_SIZE)
    numbers = rng.standard_normal((_FAMILY_SIZE, features, len(goal)))
    few = _carry(task, goal, _FAMILY_SAMPLES)
    trajectories = np.concatenate(
        [few.mean(axis=0, keepdims=True), few, few[base] + _detours(numbers, _FAMILY_SAMPLES)]
    )
    paths = task.paths(trajectories, task.moving)
    radius = task.spheres.radius[task.moving]
    steps = np.sqrt((np.diff(paths, axis=1) ** 2).sum(axis=-1)).max(axis=(1, 2)) + 1e-9
    hit = sampling_kernels.blocked_paths(paths, radius, steps, bodies, _BLOCKING_DEPTH)
    return _Family(
        carried=_carry(task, goal, _WITNESS_SAMPLES),
        numbers=numbers,
        base=base,
        paths=paths,
        radius=radius,
        steps=steps,
        free=~hit.any(axis=0),
    )


def _row(obstacle: Obstacle) -> list[float]:
    """Return an upright obstacle as a row for the kernels."""
    _, _, z, w = obstacle.quaternion
    yaw = 2.0 * np.arctan2(z, w)
    return [
        float(SHAPES.index(obstacle.shape)),
        *obstacle.position,
        float(np.cos(yaw)),
        float(np.sin(yaw)),
        *obstacle.size,
    ]


def _obstacle(row: FloatArray) -> Obstacle:
    yaw = float(np.arctan2(row[5], row[4]))
    return Obstacle(
        shape=SHAPES[int(row[0])],  # type: ignore[arg-type]
        position=(float(row[1]), float(row[2]), float(row[3])),
        quaternion=(0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2))),
        size=(float(row[6]), float(row[7]), float(row[8])),
    )


def _witness_path(
    task: _Task, trajectory: FloatArray, bodies: FloatArray
) -> FloatArray | None:
    """Return the (W, S, 3) path of all spheres of a good witness, or None if it is not good."""
    low = kinematics.JOINT_LOWER + _LIMIT_MARGIN
    high = kinematics.JOINT_UPPER - _LIMIT_MARGIN
    if (trajectory < low).any() or (trajectory > high).any():
        return None
    if _duration(trajectory) > _MAX_DURATION:
        return None
    path = task.paths(trajectory[None])[0]
    moving = np.ascontiguousarray(path[:, task.moving])
    radius = task.spheres.radius[task.moving]
    enough = 2.0 * _FIXTURE_CLEARANCE
    if sampling_kernels.path_clearance(moving, radius, bodies, enough) < _FIXTURE_CLEARANCE:
        return None
    if sampling_kernels.self_clearance(path, task.spheres.radius, task.pairs) < _SELF_CLEARANCE:
        return None
    return path


def _candidates(
    family: _Family, free: NDArray[np.bool_], rng: np.random.Generator
) -> FloatArray:
    """Return (_CANDIDATES, 9) rows of obstacles near the paths of members that are still free."""
    count = _CANDIDATES
    pool = np.flatnonzero(free) if free.any() else np.arange(len(free))
    member = pool[rng.integers(len(pool), size=count)]
    sample = rng.integers(_FAMILY_SAMPLES, size=count)
    sphere = rng.integers(family.paths.shape[2], size=count)
    shape = rng.choice(len(SHAPES), size=count, p=_SHAPE_SHARES)
    size = rng.uniform(*_HALF_EXTENTS, size=(count, 3))
    size[shape > 0, 1] = size[shape > 0, 0]
    size[shape == 2, 2] = size[shape == 2, 0]
    yaw = rng.uniform(-np.pi, np.pi, size=count)
    offset = rng.standard_normal((count, 3))
    offset *= rng.uniform(size=(count, 1)) / np.sqrt((offset**2).sum(axis=1, keepdims=True))
    reach = family.radius[sphere] + size.min(axis=1)
    position = family.paths[member, sample, sphere] + offset * reach[:, None]
    on_table = rng.uniform(size=count) < _TABLE_SHARE
    position[:, 2] = np.where(on_table, size[:, 2], position[:, 2])
    return np.column_stack([shape, position, np.cos(yaw), np.sin(yaw), size])


def _admissible(
    rows: FloatArray,
    placed: list[FloatArray],
    task: _Task,
    goal: Goal,
    start: FloatArray,
    witness: FloatArray,
    clearance: float,
) -> NDArray[np.bool_]:
    """Return which obstacles (C, 9) leave table, bin, each other, start and witness free."""
    half, position = rows[:, 6:9], rows[:, 1:4]
    width = np.where(rows[:, 0] == 0, np.hypot(half[:, 0], half[:, 1]), half[:, 0])
    good: NDArray[np.bool_] = position[:, 2] >= half[:, 2]
    bin_half = BIN_INNER_HALF_WIDTH + BIN_WALL_THICKNESS
    aside = np.abs(position[:, :2] - np.asarray(goal.position[:2])).max(axis=1)
    good &= aside >= bin_half + width + _GOAL_CLEARANCE
    for other in placed:
        other_width = np.hypot(other[6], other[7]) if other[0] == 0 else other[6]
        apart = np.hypot(position[:, 0] - other[1], position[:, 1] - other[2]) >= 0.8 * (
            width + other_width
        )
        good &= apart | (np.abs(position[:, 2] - other[3]) >= half[:, 2] + other[8])
    radius = task.spheres.radius
    for c in np.flatnonzero(good):
        row = rows[c : c + 1]
        good[c] = (
            sampling_kernels.path_clearance(start, radius, row, 1.0) >= _START_CLEARANCE
            and sampling_kernels.path_clearance(witness, radius, row, 1.0) >= clearance
        )
    return good


def _place_obstacles(
    task: _Task,
    family: _Family,
    goal: Goal,
    witness: FloatArray,
    specification: DifficultySpecification,
    rng: np.random.Generator,
) -> tuple[list[FloatArray], NDArray[np.bool_]]:
    """Return the rows of obstacles and which members of the family they leave free."""
    start = task.paths(task.start[None, None])[0]
    free = family.free.copy()
    free[0] = True
    placed: list[FloatArray] = []
    for _ in range(specification.obstacles):
        rows = _candidates(family, free, rng)
        good = _admissible(rows, placed, task, goal, start, witness, specification.clearance)
        rows = rows[good]
        if not len(rows):
            continue
        members = np.flatnonzero(free)
        blocked = sampling_kernels.blocked_paths(
            family.paths[members], family.radius, family.steps[members], rows, _BLOCKING_DEPTH
        )
        worth = blocked.sum(axis=1)
        if free[0]:
            worth = worth + len(free) * blocked[:, 0]
        best = int(np.argmax(worth))
        placed.append(rows[best])
        free[members[blocked[best]]] = False
    return placed, free


def sample_with_witness(
    task: str, difficulty: str, seed: int, version: int = 0
) -> tuple[Scene, FloatArray]:
    """Return a scene and a trajectory that solves it.

    Args:
        task: name of the task, one of `smp_gym.scene.TASKS`.
        difficulty: one of `smp_gym.scene.DIFFICULTIES`.
        seed: not negative; below `smp_gym.scene.EVALUATION_SEEDS_START` for tuning, from there on
            for evaluation.
        version: version of the task's scene distribution.

    Returns:
        The scene, and the witness (200, 6) in rad at equal steps of phase: from the scene's start to
        the release, within joint limits, executable in 14 s within the velocity limits.

    Raises:
        ValueError: no such task or difficulty, or a negative seed.
    """
    if task not in TASKS:
        raise ValueError(f"task must be one of {', '.join(TASKS)}; got {task!r}")
    if difficulty not in SPECIFICATIONS:
        raise ValueError(f"difficulty must be one of {', '.join(DIFFICULTIES)}; got {difficulty!r}")
    if seed < 0:
        raise ValueError(f"seed must not be negative, got {seed}")
    specification = SPECIFICATIONS[difficulty]
    rng = np.random.Generator(np.random.PCG64(_seed_sequence(task, difficulty, seed, version)))
    data = _placement()
    for _ in range(_MAX_GOALS):
        found = _attempt(data, specification, rng)
        if found is not None:
            break
    else:
        raise RuntimeError(f"no solvable scene found for {task}, {difficulty}, seed {seed}")
    goal, rows, witness = found
    scene = Scene(
        task=task,
        version=version,
        difficulty=difficulty,  # type: ignore[arg-type]
        seed=seed,
        start=tuple(float(q) for q in data.start),  # type: ignore[arg-type]
        manipulated=ManipulatedObject(),
        goals=(goal,),
        obstacles=tuple(_obstacle(row) for row in rows),
    )
    return scene, witness


def _attempt(
    task: _Task, specification: DifficultySpecification, rng: np.random.Generator
) -> tuple[Goal, list[FloatArray], FloatArray] | None:
    """Draw one goal and obstacles for it; None where no witness of the family serves."""
    try:
        goal, configuration = _draw_goal(task, rng)
    except kinematics.UnreachableError:
        return None
    bare = Scene(task="Placement", start=tuple(task.start.tolist()), goals=(goal,))
    bodies = np.array([_row(body) for body in fixtures(bare)])
    family = _draw_family(task, configuration, bodies, rng)
    offset = 1 + len(task.demonstrations)
    tried = 0
    best: tuple[int, list[FloatArray], FloatArray] | None = None
    for index in np.flatnonzero(family.free[offset:]):
        witness = family.member(int(index))
        path = _witness_path(task, witness, bodies)
        if path is None:
            continue
        placed, free = _place_obstacles(task, family, goal, path, specification, rng)
        tried += 1
        complete = len(placed) == specification.obstacles and (
            not free[0] or not specification.obstacles
        )
        left = int(free.sum())
        if complete and (best is None or left < best[0]):
            best = (left, placed, witness)
            if left <= specification.free_share * family.free.sum():
                break
        if tried == _MAX_WITNESSES:
            break
    return None if best is None else (goal, best[1], best[2])


def sample_scene(task: str, difficulty: str, seed: int, version: int = 0) -> Scene:
    """Return the scene of (task, version, difficulty, seed), a pure function of these.

    Args:
        task: name of the task, one of `smp_gym.scene.TASKS`.
        difficulty: one of `smp_gym.scene.DIFFICULTIES`.
        seed: not negative.
        version: version of the task's scene distribution.

    Raises:
        ValueError: no such task or difficulty, or a negative seed.
    """
    scene, _ = sample_with_witness(task, difficulty, seed, version)
    return scene
