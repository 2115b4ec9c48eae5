"""Scenes of MotionBenchMaker (Chamzas et al. 2022), read from their YAML files.

Such a file is a MoveIt planning scene as robowflex writes it. Of it, the boxes, cylinders and
spheres under ``world: collision_objects`` are read, in any orientation. What belongs to the robot
that the file was made for (its state, what it holds, its collision matrix) is left alone.

Reading needs PyYAML: ``pip install "smp-gym[motion-bench-maker]"``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from smp_gym.arrays import FloatArray, shown
from smp_gym.geometry.distance import PackedObstacles, signed_distance
from smp_gym.geometry.registry import REGISTRY
from smp_gym.optional_packages import require
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
from smp_gym.untrusted_files import parse_yaml, read_file

__all__ = ["load_obstacles", "load_scene"]

_FURNITURE = "shelf"
"""A family that only tasks have that set an object down on a body."""

_Vector = tuple[float, float, float]

_DIMENSIONS = {name: shape.dimensions for name, shape in REGISTRY.items()} | {"cone": 2}
_NUMBERS = {1: "box", 2: "sphere", 3: "cylinder", 4: "cone"}
"""Primitives of a MoveIt scene: how many dimensions each has; the numbers that
``shape_msgs/SolidPrimitive`` gives them."""

_LARGEST = 2.0
"""m: half-extents and coordinates of centres that an observation can hold."""

_NORM_TOLERANCE = 0.01
"""Largest deviation of an orientation's norm from 1: files have it rounded to three digits."""

_POINTS_PER_EDGE = 9
"""Points along each edge of a goal's body at which it is compared with obstacles."""


@dataclass(frozen=True)
class _Pose:
    """A rigid transform: rotation, and (3,) m position."""

    rotation: Rotation
    position: FloatArray

    def then(self, inner: _Pose) -> _Pose:
        """Return the composition of this pose with `inner`, which is given in its frame."""
        position = self.position + self.rotation.apply(inner.position)
        return _Pose(self.rotation * inner.rotation, position)


_IDENTITY_POSE = _Pose(Rotation.identity(), np.zeros(3))


def _document(path: Path) -> Mapping[str, Any]:
    require("motion-bench-maker", "reading MotionBenchMaker files")
    content = parse_yaml(read_file(path), "it")
    return _mapping(content, "the file")


def _mapping(value: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise ValueError(f"{where} must be a mapping, got {value!r:.60}")
    return value


def _list(value: Any, where: str) -> Sequence[Any]:
    if value is None:
        return ()
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise ValueError(f"{where} must be a list, got {value!r:.60}")
    return value


def _number(value: Any, where: str) -> float:
    # PyYAML takes 1e-05 for a text: YAML 1.1 wants a point in it.
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(f"{where} must hold finite numbers, got {shown(value)}")
    return number


def _vector(value: Any, names: str, where: str) -> FloatArray:
    """Return a vector that is written as a list, or as a mapping of these names."""
    if isinstance(value, Mapping) and set(names) <= set(value):
        value = [value[name] for name in names]
    entries = _list(value, where)
    if len(entries) != len(names):
        raise ValueError(
            f"{where} must be [{', '.join(names)}] or a mapping of these, got {value!r:.60}"
        )
    return np.array([_number(entry, where) for entry in entries])


def _pose(value: Any, where: str) -> _Pose:
    entries = _mapping(value, where)
    position = _vector(entries.get("position", (0.0, 0.0, 0.0)), "xyz", f"{where}.position")
    turn = entries.get("orientation", (0.0, 0.0, 0.0, 1.0))
    quaternion = _vector(turn, "xyzw", f"{where}.orientation")
    norm = float(np.linalg.norm(quaternion))
    if abs(norm - 1.0) > _NORM_TOLERANCE:
        raise ValueError(f"{where}.orientation must have norm 1, got {turn!r} with norm {norm:.4g}")
    return _Pose(Rotation.from_quat(quaternion), position)


def _body(primitive: Any, pose: _Pose, where: str) -> Obstacle | None:
    """Return a primitive as an obstacle; None for a cone, which is none."""
    entries = _mapping(primitive, where)
    kind = entries.get("type")
    shape = _NUMBERS.get(kind, kind) if isinstance(kind, int) else kind
    shape = shape.lower() if isinstance(shape, str) else shape
    if shape not in _DIMENSIONS:
        raise ValueError(f"{where}.type must be one of {', '.join(_DIMENSIONS)}; got {kind!r}")
    given = _list(entries.get("dimensions"), f"{where}.dimensions")
    if len(given) != _DIMENSIONS[shape]:
        raise ValueError(
            f"{where}.dimensions of a {shape} must be {_DIMENSIONS[shape]} numbers, got "
            f"{list(given)}"
        )
    dimensions = [_number(entry, f"{where}.dimensions") for entry in given]
    if min(dimensions) <= 0.0:
        raise ValueError(f"{where}.dimensions must be positive, got {dimensions}")
    if shape == "cone":
        return None
    a, b, c = REGISTRY[shape].of_dimensions(dimensions).tolist()
    x, y, z = pose.position.tolist()
    qx, qy, qz, qw = pose.rotation.as_quat().tolist()
    return Obstacle(
        shape=shape,
        position=(x, y, z),
        quaternion=(qx, qy, qz, qw),
        size=(a, b, c),
    )


def _bodies(
    number: int, entry: Any, base: _Pose, skip_unsupported: bool
) -> Iterator[tuple[str, Obstacle]]:
    """Yield the bodies of a collision object, each with a name for messages."""
    item = _mapping(entry, f"collision_objects[{number}]")
    name = f"{item.get('id', number)!s}"
    operation = str(item.get("operation", "add")).lower()
    if operation not in ("add", "append", "0", "2"):
        raise ValueError(f"{name}.operation must be 'add' or 'append', got {operation!r}")
    unsupported = [kind for kind in ("meshes", "planes") if item.get(kind)]
    if unsupported and not skip_unsupported:
        raise ValueError(
            f"{name} has {unsupported[0]}, which cannot be obstacles; skip_unsupported=True leaves "
            "them out"
        )
    own = _pose(item["pose"], f"{name}.pose") if item.get("pose") else _IDENTITY_POSE
    primitives = _list(item.get("primitives"), f"{name}.primitives")
    poses = _list(item.get("primitive_poses"), f"{name}.primitive_poses")
    if not poses and item.get("pose"):
        poses = [{}] * len(primitives)
    if len(poses) != len(primitives):
        raise ValueError(
            f"{name} must have a pose for each of its {len(primitives)} primitives, got "
            f"{len(poses)}"
        )
    for index, (primitive, given) in enumerate(zip(primitives, poses, strict=True)):
        pose = base.then(own).then(_pose(given, f"{name}.primitive_poses[{index}]"))
        where = f"{name}.primitives[{index}]"
        body = _body(primitive, pose, where)
        if body is not None:
            yield name, body
        elif not skip_unsupported:
            raise ValueError(
                f"{where} is a cone, which cannot be an obstacle; skip_unsupported=True leaves it "
                "out"
            )


def _check_frames(items: Sequence[Any]) -> None:
    frames = {
        str((item.get("header") or {}).get("frame_id", "world")).lstrip("/")
        for item in items
        if isinstance(item, Mapping) and isinstance(item.get("header") or {}, Mapping)
    }
    if len(frames) > 1:
        raise ValueError(
            f"all collision objects must be in one frame, got {', '.join(sorted(frames))}"
        )


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
        path: of the YAML file.
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
        ImportError: PyYAML is not installed.
    """
    file = Path(path)
    shift = np.array([_number(entry, "offset") for entry in offset])
    if shift.shape != (3,):
        raise ValueError(f"offset must be (x, y, z), got {offset!r}")
    base = _Pose(Rotation.from_rotvec([0.0, 0.0, _number(yaw, "yaw")]), shift)
    try:
        return tuple(body for _, body in _read(file, base, skip_unsupported))
    except ValueError as error:
        raise ValueError(f"{file} is no scene that can be used: {error}") from error


def _read(file: Path, base: _Pose, skip_unsupported: bool) -> list[tuple[str, Obstacle]]:
    world = _mapping(_document(file).get("world"), "world")
    if world.get("octomap") and not skip_unsupported:
        raise ValueError("world has an octomap; skip_unsupported=True leaves it out")
    items = _list(world.get("collision_objects"), "world.collision_objects")
    _check_frames(items)
    reach = _reach()
    bodies = [
        (name, body)
        for number, item in enumerate(items)
        for name, body in _bodies(number, item, base, skip_unsupported)
        if _matters(body, reach)
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
        path: of the YAML file.
        task: one that sets an object down: "Placement" or "DoubleSidedPlacement".
        seed: of the scene without obstacles that gives start and goals, not negative.
        offset: see `load_obstacles`, as the rest.
        yaw: turn of the file's frame, rad.
        skip_unsupported: what to do about what cannot be an obstacle.

    Raises:
        OSError: the file cannot be read.
        ValueError: as `load_obstacles`; no such task, or an obstacle stands in a goal's place.
        ImportError: PyYAML is not installed.
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
