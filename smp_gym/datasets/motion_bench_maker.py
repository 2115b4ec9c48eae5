"""Scenes of MotionBenchMaker (Chamzas et al. 2022) for the arm of the environments.

Of such a file, a MoveIt planning scene (`smp_gym.datasets.moveit_scene`), the boxes, cylinders and
spheres under ``world: collision_objects`` are read, in any orientation. What belongs to the robot
that the file was made for (its state, what it holds, its collision matrix) is left alone.
"""

from __future__ import annotations

from os import PathLike
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from smp_gym.arrays import FloatArray, checked_array, checked_number
from smp_gym.datasets.moveit_scene import bodies_of, has_octomap, read_message
from smp_gym.geometry.distance import PackedObstacles, signed_distance
from smp_gym.geometry.pose import Pose
from smp_gym.geometry.registry import REGISTRY
from smp_gym.robot import kinematics
from smp_gym.sampling import sample_scene
from smp_gym.scene import (
    MAX_OBSTACLES,
    ManipulatedObject,
    Obstacle,
    Scene,
    goal_boxes,
)
from smp_gym.tasks.registry import task_families, task_names

__all__ = ["load_obstacles", "load_scene"]

_FURNITURE = "shelf"
"""A family that only tasks have that set an object down on a body."""

_Vector = tuple[float, float, float]

_LARGEST = 2.0
"""m: half-extents and coordinates of centres that an observation can hold."""

_POINTS_PER_EDGE = 9
"""Points along each edge of a goal's body at which it is compared with obstacles."""


def _reach() -> float:
    """Return a distance from the base, m, that no point of arm, hand or held object gets beyond."""
    frames = np.concatenate([kinematics.BASE_TRANSFORM[None], kinematics.JOINT_ORIGINS])
    along = np.cumsum(np.linalg.norm(frames[:, :3, 3], axis=1))
    held = np.eye(4)
    held[:3, 3] = kinematics.GRASP_CENTER
    spheres = kinematics.concatenate(
        kinematics.arm_spheres(),
        kinematics.finger_spheres(np.zeros(4)),
        kinematics.box_spheres(ManipulatedObject().size, held),
    )
    beyond = np.linalg.norm(spheres.center, axis=1) + spheres.radius
    return float((along[spheres.link] + beyond).max())


def _matters(body: Obstacle, reach: float) -> bool:
    """Return whether a body reaches above the table and to where the arm can get."""
    half = PackedObstacles.of([body]).half_extents[0]
    gap = np.maximum(np.abs(np.array(body.position)) - half, 0.0)
    return bool(body.position[2] + half[2] > 0.0 and np.linalg.norm(gap) < reach)


def load_obstacles(
    path: str | PathLike[str],
    *,
    offset: _Vector = (0.0, 0.0, 0.0),
    yaw: float = 0.0,
    skip_unsupported: bool = False,
) -> tuple[Obstacle, ...]:
    """Read the obstacles of a MotionBenchMaker scene.

    Bodies that lie wholly under the table top (z = 0), or out of the arm's reach, are left out:
    nothing can touch them.

    Args:
        path: of the file, in YAML or MoveIt's text format (``.scene``).
        offset: where the origin of the file's frame lies in ours, m. Their robots stand elsewhere:
            a Fetch, for example, stands on the floor.
        yaw: turn of the file's frame about our vertical, rad.
        skip_unsupported: leave out meshes, planes, cones and octomaps instead of refusing them.

    Returns:
        The bodies in the file's order, at most `smp_gym.scene.MAX_OBSTACLES`.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is not a scene, holds something that cannot be an obstacle, or too many or
            too large bodies; the message names file, object, field and value.
        ImportError: the file is in YAML, and PyYAML is not installed.
    """
    file = Path(path)
    turn = Rotation.from_rotvec([0.0, 0.0, checked_number("yaw", yaw)])
    base = Pose(turn, checked_array("offset", offset, (3,)))
    try:
        return tuple(body for _, body in _read(file, base, skip_unsupported))
    except ValueError as error:
        raise ValueError(f"{file} is no scene that can be used: {error}") from error


def _read(file: Path, base: Pose, skip_unsupported: bool) -> list[tuple[str, Obstacle]]:
    message = read_message(file)
    if has_octomap(message) and not skip_unsupported:
        raise ValueError("world has an octomap; skip_unsupported=True leaves it out")
    found = list(bodies_of(message))
    frames = sorted({body.frame for body in found})
    if len(frames) > 1:
        raise ValueError(f"all collision objects must be in one frame, got {', '.join(frames)}")
    unsupported = [body for body in found if body.kind not in REGISTRY]
    if unsupported and not skip_unsupported:
        raise ValueError(
            f"{unsupported[0].where} is a {unsupported[0].kind}, which cannot be an obstacle; "
            "skip_unsupported=True leaves it out"
        )
    reach = _reach()
    bodies = [
        (body.name, obstacle)
        for body in found
        if body.kind in REGISTRY and _matters(obstacle := body.obstacle(base), reach)
    ]
    for name, body in bodies:
        if max(*map(abs, body.position), *body.size) > _LARGEST:
            raise ValueError(
                f"{name} must have its centre and half-extents within {_LARGEST} m, got centre "
                f"{body.position} and half-extents {body.size}"
            )
    if len(bodies) > MAX_OBSTACLES:
        raise ValueError(
            f"at most {MAX_OBSTACLES} bodies may be within reach, got {len(bodies)}: "
            f"{', '.join(name for name, _ in bodies)}"
        )
    return bodies


def _points_of(body: Obstacle) -> FloatArray:
    """Return points on a grid over an upright box, (N, 3) m."""
    steps = np.linspace(-1.0, 1.0, _POINTS_PER_EDGE)
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.array(body.position) + grid * np.array(body.size)


def load_scene(
    path: str | PathLike[str],
    task: str = "Placement",
    seed: int = 0,
    *,
    offset: _Vector = (0.0, 0.0, 0.0),
    yaw: float = 0.0,
    skip_unsupported: bool = False,
) -> Scene:
    """Return a scene to play: the obstacles of a file, start and goals of a task.

    Nothing says that it can be solved: a planner may find out. An environment plays it with
    ``reset(options={"scene": scene})``, and refuses it if the arm touches an obstacle at the start.

    Args:
        path: of the file.
        task: one that sets an object down: "Placement" or "DoubleSidedPlacement".
        seed: of the scene without obstacles that gives start and goals, not negative.
        offset: see `load_obstacles`, as the rest.
        yaw: turn of the file's frame, rad.
        skip_unsupported: what to do about what cannot be an obstacle.

    Raises:
        OSError: the file cannot be read.
        ValueError: as `load_obstacles`; no such task, or an obstacle stands in a goal's place.
        ImportError: the file is in YAML, and PyYAML is not installed.
    """
    allowed = [name for name in task_names() if _FURNITURE in task_families(name)]
    if task not in allowed:
        raise ValueError(f"task must be one of {', '.join(allowed)}; got {task!r}")
    bare = sample_scene(task, "none", seed)
    obstacles = load_obstacles(path, offset=offset, yaw=yaw, skip_unsupported=skip_unsupported)
    for goal in bare.goals:
        points = np.concatenate([_points_of(box) for box in goal_boxes(goal)])
        for number, obstacle in enumerate(obstacles):
            if (signed_distance(points, [obstacle]) < 0.0).any():
                raise ValueError(
                    f"obstacle {number}, a {obstacle.shape} at {obstacle.position} m, stands in "
                    f"the {goal.kind} at {goal.position} m: choose another offset or seed"
                )
    return bare.model_copy(update={"difficulty": "custom", "seed": None, "obstacles": obstacles})
