"""The movements of PushLiftBox as one way, and what its episodes draw."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.robot import kinematics
from smp_gym.sampling.body import ObjectTask, make_task
from smp_gym.sampling.conversion import to_row
from smp_gym.sampling.push import Push
from smp_gym.sampling.specification import SPECIFICATIONS, DifficultySpecification
from smp_gym.scene import Goal, ManipulatedObject, Obstacle
from smp_gym.tasks.push_lift_box import rules as push_lift_box

__all__ = ["draw_box", "draw_lift", "draw_target", "lift_specification", "standing"]

FloatArray = NDArray[np.float64]


_FREE_SHARES = {"none": 1.0, "easy": 0.10, "medium": 0.05, "hard": 0.02}
_FAMILY_SAMPLES = 36
_WIDE_DETOURS = 240
_WIDEST = 3.0
"""Where a push divides the way: detours have less room near it, a witness needs two that get by,
before and after, and the shorter ways bend more sharply."""

_PUSH_KNOTS = 5
"""Configurations on the way of a push for which inverse kinematics is solved; between them it is
interpolated."""


@functools.lru_cache(maxsize=1)
def _push_lift_task() -> ObjectTask:
    """Return what sampling needs to know of PushLiftBox, with the push of a nominal box."""
    demonstrations = Demonstrations.load("PushLiftBox")
    goals = np.array([scene.goals[0].position for scene in demonstrations.scenes])
    held = np.array(demonstrations.metadata["object_in_hand"])
    task = make_task(
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
        samples=_FAMILY_SAMPLES,
        wide=_WIDE_DETOURS,
        widest=_WIDEST,
    )
    return _with_push(task, (begin, end), after, box)


def _with_push(
    task: ObjectTask,
    phases: tuple[float, float],
    grasped: kinematics.SphereSet,
    box: ManipulatedObject,
) -> ObjectTask:
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
    push = Push(
        phases=phases,
        spheres=grasped,
        configurations=np.array(configurations[::-1]),
        object_path=path[:, None],
        object_radius=np.array([np.linalg.norm(box.size)]),
        object_row=np.array([to_row(standing(box))]),
    )
    return replace(task, push=push)


def standing(box: ManipulatedObject) -> Obstacle:
    """Return a box that stands on the table, as a body."""
    assert box.position is not None
    half = box.yaw / 2
    quaternion = (0.0, 0.0, float(np.sin(half)), float(np.cos(half)))
    return Obstacle(shape="box", position=box.position, quaternion=quaternion, size=box.size)


def draw_box(rng: np.random.Generator) -> ManipulatedObject:
    """Return a box that stands on the table."""
    radius = rng.uniform(*push_lift_box.BOX_RADIUS)
    bearing = rng.uniform(*push_lift_box.BOX_BEARING)
    yaw = bearing + rng.uniform(-push_lift_box.BOX_TURN, push_lift_box.BOX_TURN)
    height = ManipulatedObject().size[2]
    position = (float(radius * np.cos(bearing)), float(radius * np.sin(bearing)), height)
    return ManipulatedObject(position=position, yaw=float(yaw))


def draw_target(rng: np.random.Generator) -> Goal:
    """Return a point in the air."""
    radius = rng.uniform(*push_lift_box.TARGET_RADIUS)
    bearing = rng.uniform(*push_lift_box.TARGET_BEARING)
    height = rng.uniform(*push_lift_box.TARGET_HEIGHT)
    position = (float(radius * np.cos(bearing)), float(radius * np.sin(bearing)), float(height))
    return Goal(kind="lift", position=position)


def draw_lift(
    rng: np.random.Generator,
) -> tuple[ObjectTask, ManipulatedObject, Goal] | None:
    """Draw a start, with the push of a box, that box, and a target; None if it is out of reach."""
    box, goal = draw_box(rng), draw_target(rng)
    spread = np.asarray(push_lift_box.START_SPREAD)
    start = np.asarray(push_lift_box.START_CONFIGURATION) + rng.uniform(-spread, spread)
    nominal = _push_lift_task()
    assert nominal.push is not None
    task = replace(nominal, start=start)
    try:
        task = _with_push(task, nominal.push.phases, nominal.push.spheres, box)
    except kinematics.UnreachableError:
        return None
    return task, box, goal


def lift_specification(difficulty: str) -> DifficultySpecification:
    """Return what a difficulty means for PushLiftBox."""
    return replace(SPECIFICATIONS[difficulty], free_share=_FREE_SHARES[difficulty])
