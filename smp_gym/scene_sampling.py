"""Scene sampling: (task, version, difficulty, seed) -> `Scene`, solvable by construction.

A scene is drawn in four steps:

1. A *goal* is drawn, and a configuration over it is solved for.
2. A *family* of trajectories is drawn: the demonstrations carried to that goal, their mean, and
   carried demonstrations with smooth random detours. Those with detours of ordinary width are the
   *proposals*, what a primitive fitted to the demonstrations would propose; wider ones join them as
   possible *witnesses*.
3. *Obstacles* are chosen from many random candidates, so that together they block the mean and as
   many proposals as they can, while at least one member of the family keeps its clearance from all.
4. That member, checked densely against table, bin, itself, joint and velocity limits, is the
   witness: it solves the scene.

No planner and no physics engine takes part. The witness is not part of the scene.
"""

from __future__ import annotations

import functools
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from smp_gym import kinematics, sampling_kernels
from smp_gym.demonstrations import Demonstrations
from smp_gym.scene import (
    BIN_FLOOR_THICKNESS,
    BIN_HEIGHT,
    BIN_INNER_HALF_WIDTH,
    BIN_WALL_THICKNESS,
    DIFFICULTIES,
    PAD_HALF_WIDTH,
    SHAPES,
    TASKS,
    Configuration,
    Goal,
    ManipulatedObject,
    Obstacle,
    Scene,
    fixtures,
    goal_boxes,
)
from smp_gym.tasks import double_sided_placement, placement, push_lift_box

__all__ = ["SPECIFICATIONS", "DifficultySpecification", "sample_scene", "sample_with_witness"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class DifficultySpecification:
    """What a difficulty means.

    Attributes:
        obstacles: how many.
        on_table: how many of them must stand on the table; the others stand or float.
        clearance: m, what every obstacle leaves between itself and the witness's spheres.
        free_share: share of the proposals that may stay free; where more do, it is drawn anew.
    """

    obstacles: int
    on_table: int
    clearance: float
    free_share: float


SPECIFICATIONS = {
    "none": DifficultySpecification(obstacles=0, on_table=0, clearance=0.0, free_share=1.0),
    "easy": DifficultySpecification(obstacles=2, on_table=0, clearance=0.040, free_share=0.03),
    "medium": DifficultySpecification(obstacles=4, on_table=1, clearance=0.030, free_share=0.01),
    "hard": DifficultySpecification(obstacles=6, on_table=1, clearance=0.020, free_share=0.0),
}
"""Difficulties by name."""

_DEFAULT_OBJECT = ManipulatedObject()
_PLACEMENT = "Placement"
_DOUBLE_SIDED = "DoubleSidedPlacement"
_PUSH_LIFT = "PushLiftBox"

_OBSTACLES_BY_SIDE = {"none": (0, 0), "easy": (2, 2), "medium": (4, 4), "hard": (6, 1)}
_FREE_SHARES = {"none": (1.0, 1.0), "easy": (0.03, 0.03), "medium": (0.01, 0.0), "hard": (0.0, 0.0)}
"""Of DoubleSidedPlacement: obstacles on the way to the one and to the other pad, and which share of
the proposals for each may stay free. Where the numbers of obstacles differ, the other side is
closed off: its only obstacle stands on the pad and leaves no room there."""

_STOPPER_HALF_EXTENTS = (0.05, 0.06)
"""m, of what stands on a pad that is closed off: between it and the pad's edge no object fits with
its centre over the pad."""

_DETOUR_STD = 0.2
_DETOUR_LENGTH = 0.2
"""Standard deviation (rad) and length scale (phase) of the detours, those of the primitive's smooth
covariance: what it can propose is what has to be blocked."""

_PROPOSALS = 104
_WIDE = 56
_WIDEST = 2.5
"""Detours of ordinary width, and wider ones, up to so many times as wide."""

_FAMILY_SAMPLES = 20

_FREE_SHARES_WITH_PUSH = {"none": 1.0, "easy": 0.10, "medium": 0.05, "hard": 0.02}
_FAMILY_SAMPLES_WITH_PUSH = 36
_WIDE_WITH_PUSH = 240
_WIDEST_WITH_PUSH = 3.0
"""Where a push divides the way: detours have less room near it, a witness needs two that get by,
before and after, and the shorter ways bend more sharply."""

_WITNESS_SAMPLES = 200

_MAX_DURATION = 14.0
"""Seconds: longest witness, at constant speed of phase within the joint velocity limits."""

_FIXTURE_CLEARANCE = 0.010
_SELF_CLEARANCE = 0.005
_LIMIT_MARGIN = 0.05
"""Witness: distance (m) to table and bin, to itself, and (rad) to the joint limits."""

_HAND_LINK = 5
_BASE_DISTANCE = 0.35
"""Obstacles stand in the way of the hand: near spheres from this link on, and so far (m) from the
axis of the base. Nearer to it they would block more, but the shoulder, not the way."""

_START_CLEARANCE = 0.05
_GOAL_CLEARANCES = {"bin": 0.03, "pad": 0.01, "lift": 0.03}
_OVERLAP = 0.8
"""Obstacles: distance (m) to the robot at the start, sideways to bin or pad, and how near their
axes may come, as a share of the sum of their widths."""

_BLOCKING_DEPTH = 0.015
"""Metres: how deep an obstacle reaches into the covering spheres before a path counts as blocked.
The spheres stand out of the arm's shapes by about that much."""

_HALF_WIDTHS = {
    "bin": BIN_INNER_HALF_WIDTH + BIN_WALL_THICKNESS,
    "pad": PAD_HALF_WIDTH,
    "lift": max(ManipulatedObject().size),
}
"""m, of the bodies of goals, or of the object that is lifted to one."""

_PUSH_KNOTS = 5
"""Configurations on the way of a push for which inverse kinematics is solved; between them it is
interpolated."""

_HALF_EXTENTS = (0.03, 0.06)
_TABLE_SHARE = 0.35
_SHAPE_SHARES = (0.5, 0.3, 0.2)
"""Obstacles: range of half-extents (m), share that stands on the table, shares of `SHAPES`."""

_CANDIDATES = 1200
_PAIRED_CANDIDATES = 200
_REPEATED = 0.1
"""How many obstacles are drawn to choose from, how many of the most blocking are compared in pairs,
and what blocking a proposal counts for each obstacle that blocks it already."""

_GRID_ORIGIN = np.array([-0.2, -0.9, 0.0])
_GRID_SPACING = 0.04
_GRID_SHAPE = (31, 46, 29)
"""Grid of points (m) on which candidates are compared; it holds all that the arm can reach in front
of it. What is chosen is checked without the grid."""

_GRID_SLACK = 0.02
"""Metres added to the clearance on the grid, for what lies between its points and the samples."""

_CANDIDATE_SETS = 2
_WAY_DRAWS = 6
_MAX_CHOICES = 8
_MAX_DRAWS = 200
"""How many sets of candidates are tried with a family, how many families on the second of two ways,
how many choices with a set, and how many goals and families in all."""


def _configuration(q: FloatArray) -> Configuration:
    a, b, c, d, e, f = q.tolist()
    return a, b, c, d, e, f


def _seed_sequence(task: str, difficulty: str, seed: int, version: int) -> np.random.SeedSequence:
    name = zlib.crc32(f"{task}/{difficulty}".encode())
    return np.random.SeedSequence([name, version, seed])


def _smoothstep(phase: FloatArray) -> FloatArray:
    """Minimum-jerk blend from 0 to 1 with velocity and acceleration zero at both ends."""
    return np.asarray(phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2))


@functools.lru_cache(maxsize=8)
def _detour_basis(samples: int, pins: tuple[float, ...] = (0.0, 1.0)) -> FloatArray:
    """Return (samples, F): a detour is this times F standard normal numbers, in units of its std.

    A stationary Gaussian process with squared-exponential kernel, written as a Fourier series of
    period 2 (twice the phase, so that its ends do not feel each other) and conditioned in closed
    form on value and velocity zero at the pins, phases of which the first and last are 0 and 1;
    between the inner pins, where there are two, it is zero. No matrix factorisation is needed, so
    the result does not depend on the number of threads of a linear algebra library.
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

    ends = np.concatenate(features(np.array(pins)))
    value, _ = features(phase)
    gain = np.einsum("tf,cf->tc", value, ends)
    gram = np.einsum("cf,df->cd", ends, ends)
    correction = np.einsum("tc,cd,df->tf", gain, np.linalg.inv(gram), ends)
    basis: FloatArray = value - correction
    basis[[0, -1]] = 0.0
    if len(pins) > 2:
        basis[(phase >= pins[1]) & (phase <= pins[2])] = 0.0
    return basis


def _detours(numbers: FloatArray, samples: int, pins: tuple[float, ...]) -> FloatArray:
    """Return (N, samples, 6) rad from (N, F, 6) standard normal numbers."""
    return _DETOUR_STD * np.einsum("tf,nfj->ntj", _detour_basis(samples, pins), numbers)


def _resample(trajectories: FloatArray, samples: int) -> FloatArray:
    """Return (N, samples, 6): (N, T, 6) at other equal steps of phase, linearly between samples."""
    at = np.linspace(0.0, trajectories.shape[1] - 1.0, samples)
    low = np.minimum(at.astype(np.int64), trajectories.shape[1] - 2)
    part = (at - low)[:, None]
    return trajectories[:, low] * (1.0 - part) + trajectories[:, low + 1] * part


@dataclass(frozen=True, eq=False)
class _Push:
    """A push on the way, after which the hand holds the object.

    Attributes:
        phases: of its begin, the hand behind the object, and of its end, the hand closing.
        spheres: as `_Body.spheres`, which hold until it ends, but with the fingers closed and the
            object between them. Before, the object's spheres rest within the palm.
        configurations: (K, 6) rad, at equal steps of its way.
        object_path: (K, 1, 3) m, where the object's centre is meanwhile.
        object_radius: (1,) m, of a sphere around the object.
        object_row: (1, 9) the object before the push, as a row for the kernels.
    """

    phases: tuple[float, float]
    spheres: kinematics.SphereSet
    configurations: FloatArray
    object_path: FloatArray
    object_radius: FloatArray
    object_row: FloatArray

    def at(self, phase: FloatArray) -> FloatArray:
        """Return the configurations (T, 6) rad at phases (T,); at rest outside of the push."""
        begin, end = self.phases
        share = _smoothstep(np.clip((phase - begin) / (end - begin), 0.0, 1.0))
        knots = np.linspace(0.0, 1.0, len(self.configurations))
        # The polynomial through all knots (Lagrange): the joints' ways are smooth.
        weights = np.stack(
            [
                np.prod(
                    [(share - other) / (knot - other) for other in knots if other != knot], axis=0
                )
                for knot in knots
            ],
            axis=1,
        )
        return np.asarray(np.einsum("tk,kj->tj", weights, self.configurations))


@dataclass(frozen=True, eq=False)
class _Body:
    """The demonstrated movements, and the body that moves; built once per process.

    Attributes:
        demonstrations: (N, T, 6) rad.
        spheres: arm, fingers and what the hand holds.
        moving: index of the spheres that could touch the table.
        swept: index of the spheres that the family is compared by: those but for the fingers, which
            lie between palm and object.
        pairs: (P, 2) spheres that may not touch each other.
        push: what comes before the hand holds the object, if it does not from the start.
    """

    demonstrations: FloatArray
    spheres: kinematics.SphereSet
    moving: NDArray[np.int64]
    swept: NDArray[np.int64]
    pairs: NDArray[np.int64]
    push: _Push | None = field(default=None, kw_only=True)

    def paths(self, trajectories: FloatArray, which: NDArray[np.int64] | None = None) -> FloatArray:
        """Return (N, T, S, 3) m, centres of spheres (all, or the given) along trajectories."""
        paths = self._paths(trajectories, self.spheres, which)
        if self.push is None:
            return paths
        phase = np.linspace(0.0, 1.0, trajectories.shape[-2])
        holding = (phase > self.push.phases[1])[:, None, None]
        return np.where(holding, self._paths(trajectories, self.push.spheres, which), paths)

    def _paths(
        self,
        trajectories: FloatArray,
        spheres: kinematics.SphereSet,
        which: NDArray[np.int64] | None,
    ) -> FloatArray:
        link, center = spheres.link, spheres.center
        if which is not None:
            link, center = link[which], center[which]
        flat = np.ascontiguousarray(trajectories.reshape(-1, trajectories.shape[-1]))
        centers = sampling_kernels.sphere_paths(
            flat, kinematics.BASE_TRANSFORM, kinematics.JOINT_ORIGINS, link, center
        )
        return centers.reshape(*trajectories.shape[:-1], len(link), 3)


@dataclass(frozen=True, eq=False)
class _Task(_Body):
    """What sampling needs to know of a task that sets an object down or lifts it.

    Attributes:
        start: (6,) rad.
        release_rotation: (3, 3) orientation of the end effector at the demonstrations' mean end.
        release_height: m, of the object's centre over the goal there.
        nominal_goal: (3,) m, mean goal of the demonstrations.
        held: (4, 4) pose of the held object in the end-effector frame.
        samples: of each member of a family.
        wide: how many wide detours are drawn.
        widest: up to so many times as wide as ordinary ones.
    """

    start: FloatArray
    release_rotation: FloatArray
    release_height: float
    nominal_goal: FloatArray
    held: FloatArray
    samples: int = _FAMILY_SAMPLES
    wide: int = _WIDE
    widest: float = _WIDEST

    @property
    def pins(self) -> tuple[float, ...]:
        """Phases at which detours are zero."""
        return (0.0, 1.0) if self.push is None else (0.0, *self.push.phases, 1.0)


@functools.lru_cache(maxsize=1)
def _placement() -> _Task:
    demonstrations = Demonstrations.load(_PLACEMENT)
    goals = np.array([scene.goals[0].position for scene in demonstrations.scenes])
    return _make_task(
        demonstrations.configurations,
        goals.mean(axis=0),
        placement.START_CONFIGURATION,
        placement.HELD_OBJECT_POSE,
        demonstrations.metadata["finger_angles"],
    )


@functools.lru_cache(maxsize=1)
def _double_sided() -> tuple[_Task, _Task]:
    """Return what sampling needs to know of the ways to the left and to the right."""
    demonstrations = Demonstrations.load(_DOUBLE_SIDED)
    left = kinematics.end_effector_pose(demonstrations.configurations[:, -1])[:, 1, 3] > 0.0
    tasks = [
        _make_task(
            demonstrations.configurations[of_side],
            np.array([scene.goals[side].position for scene in demonstrations.scenes]).mean(axis=0),
            double_sided_placement.START_CONFIGURATION,
            double_sided_placement.HELD_OBJECT_POSE,
            demonstrations.metadata["finger_angles"],
        )
        for side, of_side in enumerate((left, ~left))
    ]
    return tasks[0], tasks[1]


def _make_task(
    demonstrations: FloatArray,
    goal: FloatArray,
    start: Configuration,
    held: FloatArray,
    finger_angles: list[float],
) -> _Task:
    parts = (
        kinematics.arm_spheres(),
        kinematics.finger_spheres(finger_angles),
        kinematics.box_spheres(ManipulatedObject().size, held),
    )
    spheres = kinematics.concatenate(*parts)
    moving = np.flatnonzero(spheres.link >= 2)
    first_finger = len(parts[0])
    fingers = np.arange(first_finger, first_finger + len(parts[1]))
    pose = kinematics.end_effector_pose(demonstrations.mean(axis=0)[-1])
    return _Task(
        demonstrations=demonstrations,
        start=np.asarray(start, np.float64),
        spheres=spheres,
        moving=moving,
        swept=np.setdiff1d(moving, fingers),
        pairs=kinematics.self_collision_pairs(spheres),
        release_rotation=pose[:3, :3],
        release_height=float((pose @ held)[2, 3] - goal[2]),
        nominal_goal=goal,
        held=np.asarray(held),
    )


@functools.lru_cache(maxsize=1)
def _push_lift() -> _Task:
    """Return what sampling needs to know of PushLiftBox, with the push of a nominal box."""
    demonstrations = Demonstrations.load(_PUSH_LIFT)
    goals = np.array([scene.goals[0].position for scene in demonstrations.scenes])
    held = np.array(demonstrations.metadata["object_in_hand"])
    task = _make_task(
        demonstrations.configurations,
        goals.mean(axis=0),
        push_lift_box.START_CONFIGURATION,
        held,
        demonstrations.metadata["finger_angles"],
    )
    arm = kinematics.arm_spheres()
    open_fingers = kinematics.finger_spheres(np.zeros(4))
    count = len(arm) + len(open_fingers)
    palm = np.flatnonzero(arm.link == arm.link.max())
    widest = palm[np.argmax(arm.radius[palm])]
    center = task.spheres.center.copy()
    center[len(arm) : count] = open_fingers.center
    center[count:] = arm.center[widest]
    before = kinematics.SphereSet(task.spheres.link, center, task.spheres.radius)
    last = demonstrations.configurations.shape[1] - 1
    begin, end = (sample / last for sample in demonstrations.metadata["push_samples"])
    box = demonstrations.scenes[0].manipulated
    assert box is not None
    # The box touches the table when it is pushed and lifted: that is no collision.
    moving = task.moving[task.moving < count]
    after = task.spheres
    task = replace(
        task,
        spheres=before,
        moving=moving,
        swept=task.moving,
        samples=_FAMILY_SAMPLES_WITH_PUSH,
        wide=_WIDE_WITH_PUSH,
        widest=_WIDEST_WITH_PUSH,
    )
    return _with_push(task, (begin, end), after, box)


def _with_push(
    task: _Task, phases: tuple[float, float], grasped: kinematics.SphereSet, box: ManipulatedObject
) -> _Task:
    """Return a task with the push of a box.

    Raises:
        UnreachableError: the box is out of reach.
    """
    assert box.position is not None
    shares = np.linspace(0.0, 1.0, _PUSH_KNOTS)
    center = np.asarray(box.position)
    mean = task.demonstrations.mean(axis=0)
    samples = np.linspace(*phases, _PUSH_KNOTS) * (len(mean) - 1)
    configurations: list[FloatArray] = []
    for pose, sample in zip(
        push_lift_box.push_poses(center, box.yaw, shares)[::-1], samples[::-1], strict=True
    ):
        near = configurations[-1] if configurations else mean[round(sample)]
        configurations.append(kinematics.inverse_kinematics(pose[:3, 3], pose[:3, :3], seed=near))
    ahead = np.array([np.cos(box.yaw), np.sin(box.yaw), 0.0])
    path = center + shares[:, None] * push_lift_box.PUSH_LENGTH * ahead
    push = _Push(
        phases=phases,
        spheres=grasped,
        configurations=np.array(configurations[::-1]),
        object_path=path[:, None],
        object_radius=np.array([np.linalg.norm(box.size)]),
        object_row=np.array([_row(_standing(box))]),
    )
    return replace(task, push=push)


def _standing(box: ManipulatedObject) -> Obstacle:
    """Return a box that stands on the table, as a body."""
    assert box.position is not None
    half = box.yaw / 2
    quaternion = (0.0, 0.0, float(np.sin(half)), float(np.cos(half)))
    return Obstacle(shape="box", position=box.position, quaternion=quaternion, size=box.size)


def _draw_box(rng: np.random.Generator) -> ManipulatedObject:
    """Return a box that stands on the table."""
    radius = rng.uniform(*push_lift_box.BOX_RADIUS)
    bearing = rng.uniform(*push_lift_box.BOX_BEARING)
    yaw = bearing + rng.uniform(-push_lift_box.BOX_TURN, push_lift_box.BOX_TURN)
    height = ManipulatedObject().size[2]
    position = (float(radius * np.cos(bearing)), float(radius * np.sin(bearing)), height)
    return ManipulatedObject(position=position, yaw=float(yaw))


def _draw_target(rng: np.random.Generator) -> Goal:
    """Return a point in the air."""
    radius = rng.uniform(*push_lift_box.TARGET_RADIUS)
    bearing = rng.uniform(*push_lift_box.TARGET_BEARING)
    height = rng.uniform(*push_lift_box.TARGET_HEIGHT)
    position = (float(radius * np.cos(bearing)), float(radius * np.sin(bearing)), float(height))
    return Goal(kind="lift", position=position)


def _draw_goal(rng: np.random.Generator) -> Goal:
    x, y, z = rng.uniform(placement.BIN_LOWER, placement.BIN_UPPER)
    return Goal(position=(float(x), float(y), float(z)))


def _draw_pads(rng: np.random.Generator) -> tuple[Goal, ...]:
    pads = []
    for x, y, _ in double_sided_placement.NOMINAL_PADS:
        radius = double_sided_placement.PAD_SHIFT * np.sqrt(rng.uniform())
        angle = rng.uniform(-np.pi, np.pi)
        z = rng.uniform(double_sided_placement.PAD_LOWEST, double_sided_placement.PAD_TOP)
        position = (x + float(radius * np.cos(angle)), y + float(radius * np.sin(angle)), float(z))
        pads.append(Goal(kind="pad", position=position))
    return tuple(pads)


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
    held = task.held[:3, 3]
    seed = task.demonstrations[:, -1].mean(axis=0)
    seed[0] -= turn
    return kinematics.inverse_kinematics(center - rotation @ held, rotation, seed=seed)


def _carry(task: _Task, goal: FloatArray, samples: int) -> FloatArray:
    """Return the demonstrations, (N, samples, 6), blended to start and goal configuration."""
    if task.push is not None:
        return _carry_with_push(task, task.push, goal, samples)
    carried = _resample(task.demonstrations, samples)
    blend = _smoothstep(np.linspace(0.0, 1.0, samples))[:, None]
    to_start = (task.start - carried[:, 0])[:, None]
    to_goal = (goal - carried[:, -1])[:, None]
    result: FloatArray = carried + (1.0 - blend) * to_start + blend * to_goal
    return result


def _carry_with_push(task: _Task, push: _Push, goal: FloatArray, samples: int) -> FloatArray:
    """Return the demonstrations, (N, samples, 6), blended to start, push and goal configuration."""
    carried = _resample(task.demonstrations, samples)
    phase = np.linspace(0.0, 1.0, samples)
    begin, end = push.phases
    last = task.demonstrations.shape[1] - 1
    pushing = push.at(phase)
    behind, grasp = push.configurations[0], push.configurations[-1]
    to_start = task.start - task.demonstrations[:, 0]
    to_behind = behind - task.demonstrations[:, round(begin * last)]
    to_grasp = grasp - task.demonstrations[:, round(end * last)]
    to_goal = goal - task.demonstrations[:, -1]
    before = _smoothstep(np.clip(phase / begin, 0.0, 1.0))[:, None]
    after = _smoothstep(np.clip((phase - end) / (1.0 - end), 0.0, 1.0))[:, None]
    approach = carried + (1.0 - before) * to_start[:, None] + before * to_behind[:, None]
    lift = carried + (1.0 - after) * to_grasp[:, None] + after * to_goal[:, None]
    result: FloatArray = np.where((phase < begin)[:, None], approach, pushing)
    result = np.where((phase > end)[:, None], lift, result)
    return result


@dataclass(frozen=True, eq=False)
class _Family:
    """Trajectories for one goal: mean of the carried demonstrations, these, and their detours.

    Attributes:
        configuration: (6,) rad, where all of them end.
        base: (M,) which demonstration each detour belongs to.
        numbers: (M, F, 6) standard normal numbers, times the width, of the detours.
        paths: (N, T, S, 3) m, centres of the swept spheres; N = 1 + demonstrations + M.
        radius: (S,) m.
        grid: which members sweep over which grid points.
        proposals: how many, from the first, a primitive would propose.
        free: (N,) whether table and goals leave a member free.
        able: (N,) whether a member may serve as witness, as far as seen from these samples.
    """

    configuration: FloatArray
    base: NDArray[np.int64]
    numbers: FloatArray
    paths: FloatArray
    radius: FloatArray
    grid: NDArray[np.uint64]
    proposals: int
    free: BoolArray
    able: BoolArray

    def near(self, rows: FloatArray, distance: float) -> BoolArray:
        """Return (C, N), which members come within a distance (m) of which obstacles."""
        return _near(self.grid, rows, distance, len(self.paths))


def _near(grid: NDArray[np.uint64], rows: FloatArray, distance: float, members: int) -> BoolArray:
    return sampling_kernels.touched(grid, _GRID_ORIGIN, _GRID_SPACING, rows, distance, members)


def _draw_family(
    task: _Task,
    goals: tuple[Goal, ...],
    configuration: FloatArray,
    proposals: int,
    wide: int,
    rng: np.random.Generator,
) -> _Family:
    demonstrations = len(task.demonstrations)
    base = rng.integers(demonstrations, size=proposals + wide)
    features = _detour_basis(task.samples, task.pins).shape[1]
    numbers = rng.standard_normal((len(base), features, 6))
    numbers[proposals:] *= rng.uniform(1.0, task.widest, size=(wide, 1, 1))
    carried = _carry(task, configuration, task.samples)
    mean = carried.mean(axis=0, keepdims=True)
    trajectories = np.concatenate(
        [mean, carried, carried[base] + _detours(numbers, task.samples, task.pins)]
    )
    paths = task.paths(trajectories, task.swept)
    radius = task.spheres.radius[task.swept]
    grid = sampling_kernels.rasterised(paths, radius, _GRID_ORIGIN, _GRID_SPACING, _GRID_SHAPE)
    grounded = np.isin(task.swept, task.moving)
    height = (paths[..., grounded, 2] - radius[grounded]).min(axis=(1, 2))
    # The bin counts as solid here: its thin walls would fall through the grid.
    solids = np.array([_solid(goal) for goal in goals if goal_boxes(goal)])
    solids = solids.reshape(-1, sampling_kernels.OBSTACLE_COLUMNS)

    def clear(distance: float) -> BoolArray:
        near = _near(grid, solids, distance, len(paths)).any(axis=0)
        return ~near & (height > distance)

    able = clear(_FIXTURE_CLEARANCE) & _within_limits(trajectories)
    if task.push is not None:
        approach = paths[:, : int(task.push.phases[0] * (task.samples - 1)) + 1]
        steps, row = sampling_kernels.longest_steps(approach), task.push.object_row
        able &= ~sampling_kernels.blocked_paths(approach, radius, steps, row, -_FIXTURE_CLEARANCE)[
            0
        ]
    return _Family(
        configuration=configuration,
        base=base,
        numbers=numbers,
        paths=paths,
        radius=radius,
        grid=grid,
        proposals=1 + demonstrations + proposals,
        free=clear(-_BLOCKING_DEPTH),
        able=able,
    )


def _member(task: _Task, family: _Family, index: int) -> FloatArray:
    """Return member `index` of a family, (W, 6) rad, at the samples of a witness."""
    carried = _carry(task, family.configuration, _WITNESS_SAMPLES)
    if index == 0:
        mean: FloatArray = carried.mean(axis=0)
        return mean
    if index <= len(carried):
        return carried[index - 1]
    detour = index - 1 - len(carried)
    numbers = family.numbers[detour : detour + 1]
    return carried[family.base[detour]] + _detours(numbers, _WITNESS_SAMPLES, task.pins)[0]


def _within_limits(trajectories: FloatArray) -> BoolArray:
    """Return which of (..., T, 6) trajectories keep the joint limits and are quick enough."""
    low = kinematics.JOINT_LOWER + _LIMIT_MARGIN
    high = kinematics.JOINT_UPPER - _LIMIT_MARGIN
    inside = ((trajectories > low) & (trajectories < high)).all(axis=(-2, -1))
    rate = np.abs(np.diff(trajectories, axis=-2)).max(axis=-2) * (trajectories.shape[-2] - 1)
    duration = (rate / kinematics.JOINT_VELOCITY).max(axis=-1)
    quick: BoolArray = inside & (duration <= _MAX_DURATION)
    return quick


def _is_witness(
    task: _Body, trajectory: FloatArray, bodies: FloatArray, rows: FloatArray, clearance: float
) -> bool:
    """Return whether a (W, 6) trajectory solves a scene of obstacles `rows`, fixtures `bodies`."""
    if not _within_limits(trajectory):
        return False
    path = task.paths(trajectory)
    radius = task.spheres.radius
    if (sampling_kernels.path_clearances(path, radius, rows, 1.0) < clearance).any():
        return False
    if task.push is not None:
        # Nothing may knock the object over before the push begins.
        approach = path[: int(task.push.phases[0] * (len(path) - 1)) + 1]
        row = task.push.object_row
        if sampling_kernels.path_clearances(approach, radius, row, 1.0)[0] < _FIXTURE_CLEARANCE:
            return False
    # The arm's base stands on the table: only the moving spheres have to keep clear of it.
    moving = np.ascontiguousarray(path[:, task.moving])
    margins = sampling_kernels.path_clearances(moving, radius[task.moving], bodies, 1.0)
    if (margins < _FIXTURE_CLEARANCE).any():
        return False
    return bool(sampling_kernels.self_clearance(path, radius, task.pairs) >= _SELF_CLEARANCE)


def _solid(goal: Goal) -> list[float]:
    """Return the body of a goal as one box."""
    if goal.kind == "pad":
        return _row(goal_boxes(goal)[0])
    half = BIN_INNER_HALF_WIDTH + BIN_WALL_THICKNESS
    height = (BIN_HEIGHT + BIN_FLOOR_THICKNESS) / 2
    x, y, z = goal.position
    middle = z - BIN_FLOOR_THICKNESS + height
    return _row(Obstacle(shape="box", position=(x, y, middle), size=(half, half, height)))


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


def _widths(rows: FloatArray) -> FloatArray:
    """Return the (C,) horizontal radius of obstacles, m."""
    widths: FloatArray = np.where(
        rows[:, 0] == SHAPES.index("box"), np.hypot(rows[:, 6], rows[:, 7]), rows[:, 6]
    )
    return widths


def _draw_candidates(
    task: _Task, family: _Family, goals: tuple[Goal, ...], rng: np.random.Generator
) -> FloatArray:
    """Return rows of obstacles near the paths of free proposals, off table, goals and start."""
    count = _CANDIDATES
    pool = np.flatnonzero(family.free[: family.proposals])
    if not len(pool):
        return np.empty((0, sampling_kernels.OBSTACLE_COLUMNS))
    member = pool[rng.integers(len(pool), size=count)]
    sample = rng.integers(task.samples, size=count)
    hand = np.flatnonzero(task.spheres.link[task.swept] >= _HAND_LINK)
    sphere = hand[rng.integers(len(hand), size=count)]
    shape = rng.choice(len(SHAPES), size=count, p=_SHAPE_SHARES)
    size = rng.uniform(*_HALF_EXTENTS, size=(count, 3))
    box, ball = SHAPES.index("box"), SHAPES.index("sphere")
    size[shape != box, 1] = size[shape != box, 0]
    size[shape == ball, 2] = size[shape == ball, 0]
    yaw = rng.uniform(-np.pi, np.pi, size=count)
    offset = rng.standard_normal((count, 3))
    offset *= rng.uniform(size=(count, 1)) / np.sqrt((offset**2).sum(axis=1, keepdims=True))
    reach = family.radius[sphere] + size.min(axis=1)
    position = family.paths[member, sample, sphere] + offset * reach[:, None]
    on_table = rng.uniform(size=count) < _TABLE_SHARE
    position[:, 2] = np.where(on_table, size[:, 2], position[:, 2])
    rows = np.column_stack([shape, position, np.cos(yaw), np.sin(yaw), size])

    fits = np.hypot(position[:, 0], position[:, 1]) >= _BASE_DISTANCE
    fits &= position[:, 2] >= size[:, 2]
    for goal in goals:
        aside = np.abs(position[:, :2] - np.asarray(goal.position[:2])).max(axis=1)
        fits &= aside >= _HALF_WIDTHS[goal.kind] + _GOAL_CLEARANCES[goal.kind] + _widths(rows)
    rows = rows[fits]
    start, radius = task.paths(task.start[None]), task.spheres.radius
    clear = sampling_kernels.path_clearances(start, radius, rows, 1.0) >= _START_CLEARANCE
    if task.push is not None:
        path, radius = task.push.object_path, task.push.object_radius
        clear &= (
            sampling_kernels.path_clearances(path, radius, rows, 1.0) >= _GOAL_CLEARANCES["lift"]
        )
    return rows[clear]


def _apart(rows: FloatArray, others: FloatArray) -> BoolArray:
    """Return (A, B), which obstacles stand beside or over which others."""
    reach = _OVERLAP * (_widths(rows)[:, None] + _widths(others))
    distance = np.hypot(rows[:, None, 1] - others[:, 1], rows[:, None, 2] - others[:, 2])
    height = np.abs(rows[:, None, 3] - others[:, 3])
    beside: BoolArray = (distance >= reach) | (height >= rows[:, None, 8] + others[:, 8])
    return beside


def _choose(
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
    first, second = sampling_kernels.best_pair(
        sampling_kernels.packed(blocks[: len(pairs)]),
        sampling_kernels.packed(clears[: len(pairs)]),
        pairs,
    )
    if first < 0:
        return None
    chosen = [first, second]
    while len(chosen) < count:
        alive = clears[chosen].all(axis=0)
        weight = _REPEATED ** blocks[chosen].sum(axis=0)
        allowed: BoolArray = np.any(clears & alive, axis=1)
        allowed[~_apart(rows, rows[chosen]).all(axis=1)] = False
        if len(chosen) >= count - specification.on_table:
            allowed[~standing] = False
        worth = np.where(allowed, (blocks * weight).sum(axis=1), -1.0)
        best = int(np.argmax(worth))
        if worth[best] < 0:
            return None
        chosen.append(best)
    return chosen


@dataclass(frozen=True, eq=False)
class _Draw:
    """One draw: (6,) start, goals, (M, 9) rows of obstacles, (W, 6) witness, the object."""

    start: FloatArray
    goals: tuple[Goal, ...]
    rows: FloatArray
    witness: FloatArray
    manipulated: ManipulatedObject = _DEFAULT_OBJECT


def _draw_placement(difficulty: str, rng: np.random.Generator) -> _Draw | None:
    """Draw a goal, obstacles and a witness; None if they do not fit together."""
    goal = _draw_goal(rng)
    return _draw_way(_placement(), SPECIFICATIONS[difficulty], goal, (goal,), rng)


def _draw_double_sided(difficulty: str, rng: np.random.Generator) -> _Draw | None:
    """Draw two pads, obstacles on both sides and a witness; None if they do not fit together.

    One side, drawn at random, is sure to be open, and the witness goes there. The other one either
    has a witness, too, or is closed off.
    """
    goals = _draw_pads(rng)
    tasks = _double_sided()
    side = int(rng.integers(2))
    count, count_other = _OBSTACLES_BY_SIDE[difficulty]
    share, share_other = _FREE_SHARES[difficulty]
    specification = replace(SPECIFICATIONS[difficulty], obstacles=count, free_share=share)
    drawn = _draw_way(tasks[side], specification, goals[side], goals, rng)
    if drawn is None:
        return None
    if count == count_other:
        specification = replace(specification, free_share=share_other)
        for _ in range(_WAY_DRAWS if count_other else 1):
            both = _draw_way(tasks[1 - side], specification, goals[1 - side], goals, rng, drawn)
            if both is not None:
                return both
        return None
    stopper = _stopper(goals[1 - side], rng)
    path, radius = tasks[side].paths(drawn.witness), tasks[side].spheres.radius
    clearance = sampling_kernels.path_clearances(path, radius, stopper, 1.0).min()
    if clearance < max(specification.clearance, _START_CLEARANCE):
        return None
    return replace(drawn, rows=np.concatenate([drawn.rows, stopper]))


def _draw_push_lift(difficulty: str, rng: np.random.Generator) -> _Draw | None:
    """Draw a box, a target, a start, obstacles and a witness; None if they do not fit together."""
    box, goal = _draw_box(rng), _draw_target(rng)
    spread = np.asarray(push_lift_box.START_SPREAD)
    start = np.asarray(push_lift_box.START_CONFIGURATION) + rng.uniform(-spread, spread)
    nominal = _push_lift()
    assert nominal.push is not None
    task = replace(nominal, start=start)
    try:
        task = _with_push(task, nominal.push.phases, nominal.push.spheres, box)
    except kinematics.UnreachableError:
        return None
    free_share = _FREE_SHARES_WITH_PUSH[difficulty]
    specification = replace(SPECIFICATIONS[difficulty], free_share=free_share)
    drawn = _draw_way(task, specification, goal, (goal,), rng)
    return None if drawn is None else replace(drawn, manipulated=box)


def _stopper(goal: Goal, rng: np.random.Generator) -> FloatArray:
    """Return the (1, 9) row of a box that leaves no room on a pad."""
    half = rng.uniform(*_STOPPER_HALF_EXTENTS, size=3)
    x, y, z = goal.position
    size = (float(half[0]), float(half[1]), float(half[2]))
    box = Obstacle(shape="box", position=(x, y, z + size[2]), size=size)
    return np.array([_row(box)])


def _draw_way(
    task: _Task,
    specification: DifficultySpecification,
    goal: Goal,
    goals: tuple[Goal, ...],
    rng: np.random.Generator,
    before: _Draw | None = None,
) -> _Draw | None:
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
        configuration = _release_configuration(task, goal)
    except kinematics.UnreachableError:
        return None
    crowd = specification.obstacles > 0
    family = _draw_family(
        task, goals, configuration, _PROPOSALS if crowd else 0, task.wide if crowd else 0, rng
    )
    for _ in range(_CANDIDATE_SETS if crowd else 1):
        drawn = _place(task, specification, goals, family, rng, before)
        if drawn is not None:
            return drawn
    return None


def _place(
    task: _Task,
    specification: DifficultySpecification,
    goals: tuple[Goal, ...],
    family: _Family,
    rng: np.random.Generator,
    before: _Draw | None = None,
) -> _Draw | None:
    """Draw obstacles for a family and find its witness; None if too much is free or nothing."""
    count = specification.obstacles
    rows = np.empty((0, sampling_kernels.OBSTACLE_COLUMNS))
    if count:
        rows = _draw_candidates(task, family, goals, rng)
    proposed = family.free[: family.proposals]
    able = family.able.copy()
    others = rows[:0]
    if before is not None:
        others = before.rows
        path, radius = task.paths(before.witness), task.spheres.radius
        enough = specification.clearance
        kept = sampling_kernels.path_clearances(path, radius, rows, enough) >= enough
        rows = rows[kept & _apart(rows, others).all(axis=1)]
        able &= ~family.near(others, specification.clearance + _GRID_SLACK).any(axis=0)
    blocks = family.near(rows, -_BLOCKING_DEPTH)[:, : family.proposals] & proposed
    order = np.argsort(-blocks.sum(axis=1), kind="stable")
    rows, blocks = rows[order], blocks[order]
    pairs = _apart(rows[:_PAIRED_CANDIDATES], rows[:_PAIRED_CANDIDATES])
    clears = ~family.near(rows, specification.clearance + _GRID_SLACK)
    bare = Scene(task=_PLACEMENT, start=_configuration(task.start), goals=goals)
    bodies = np.array([_row(body) for body in fixtures(bare)])
    for _ in range(_MAX_CHOICES):
        choice = _choose(rows, blocks, clears & able, pairs, specification)
        if choice is None:
            return None
        together = np.concatenate([others, rows[choice]])
        free = proposed & ~_blocked(family, together)
        if count and (free[0] or free.sum() > specification.free_share * proposed.sum()):
            return None
        alive = able & clears[choice].all(axis=0)
        for index in np.flatnonzero(alive):
            witness = _member(task, family, int(index))
            if _is_witness(task, witness, bodies, together, specification.clearance):
                return _Draw(
                    task.start, goals, together, witness if before is None else before.witness
                )
        able[alive] = False
    return None


def _blocked(family: _Family, rows: FloatArray) -> BoolArray:
    """Return which proposals obstacles block, (P,), checked without the grid."""
    paths = family.paths[: family.proposals]
    steps = sampling_kernels.longest_steps(paths)
    each = sampling_kernels.blocked_paths(paths, family.radius, steps, rows, _BLOCKING_DEPTH)
    blocked: BoolArray = np.any(each, axis=0)
    return blocked


_DRAWS: dict[str, Callable[[str, np.random.Generator], _Draw | None]] = {
    _PLACEMENT: _draw_placement,
    _DOUBLE_SIDED: _draw_double_sided,
    _PUSH_LIFT: _draw_push_lift,
}


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
        The scene, and the witness (200, 6) in rad at equal steps of phase: from the scene's start
        to the release, within joint limits, executable in 14 s within the velocity limits.

    Raises:
        ValueError: no such task or difficulty, or a negative seed or version.
    """
    if task not in TASKS:
        raise ValueError(f"task must be one of {', '.join(TASKS)}; got {task!r}")
    if difficulty not in SPECIFICATIONS:
        raise ValueError(f"difficulty must be one of {', '.join(DIFFICULTIES)}; got {difficulty!r}")
    if seed < 0 or version < 0:
        raise ValueError(f"seed and version must not be negative, got {seed} and {version}")
    rng = np.random.Generator(np.random.PCG64(_seed_sequence(task, difficulty, seed, version)))
    if task == "DrawS":
        # It builds on this module.
        from smp_gym import stroke_sampling

        return stroke_sampling.sample(SPECIFICATIONS[difficulty], rng, difficulty, seed, version)
    for _ in range(_MAX_DRAWS):
        drawn = _DRAWS[task](difficulty, rng)
        if drawn is not None:
            break
    else:
        raise RuntimeError(f"no solvable scene found for {task}, {difficulty}, seed {seed}")
    scene = Scene(
        task=task,
        version=version,
        difficulty=difficulty,  # type: ignore[arg-type]
        seed=seed,
        start=_configuration(drawn.start),
        manipulated=drawn.manipulated,
        goals=drawn.goals,
        obstacles=tuple(_obstacle(row) for row in drawn.rows),
    )
    return scene, drawn.witness


def sample_scene(task: str, difficulty: str, seed: int, version: int = 0) -> Scene:
    """Return the scene of (task, version, difficulty, seed), a pure function of these.

    Args:
        task: name of the task, one of `smp_gym.scene.TASKS`.
        difficulty: one of `smp_gym.scene.DIFFICULTIES`.
        seed: not negative.
        version: version of the task's scene distribution.

    Raises:
        ValueError: no such task or difficulty, or a negative seed or version.
    """
    scene, _ = sample_with_witness(task, difficulty, seed, version)
    return scene
