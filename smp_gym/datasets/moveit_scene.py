"""Planning scenes and requests of MoveIt, read from files.

YAML files have the fields of the messages ``moveit_msgs/PlanningScene`` and
``moveit_msgs/MotionPlanRequest``, as robowflex writes them for MotionBenchMaker (Chamzas et al.
2022) and ``rosmsg`` prints them; text files (``.scene``) are those that MoveIt exports. Reading
YAML needs PyYAML: ``pip install "smp-gym[motion-bench-maker]"``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from smp_gym.arrays import FloatArray, IntArray, shown
from smp_gym.datasets.moveit_fields import (
    as_list,
    as_mapping,
    as_number,
    as_pose,
    as_transform,
    as_vector,
    frame_in_header,
    frame_name,
    named_values,
    stays,
)
from smp_gym.datasets.moveit_text import scene_message
from smp_gym.geometry.pose import Pose
from smp_gym.geometry.registry import REGISTRY
from smp_gym.optional_packages import require
from smp_gym.scene import Obstacle
from smp_gym.untrusted_files import parse_yaml, read_file

__all__ = [
    "OrientationGoal",
    "PoseGoal",
    "SceneBody",
    "base_moved",
    "bodies_of",
    "frames_of",
    "goals_of",
    "has_octomap",
    "joints_of",
    "object_bodies",
    "path_constrained",
    "read_message",
]

_LARGEST_TEXT = 16 * 2**20
"""Bytes of a text file."""

_DIMENSIONS = {name: shape.dimensions for name, shape in REGISTRY.items()} | {"cone": 2}
_NUMBERS = {1: "box", 2: "sphere", 3: "cylinder", 4: "cone"}
"""Primitives of a MoveIt scene: how many dimensions each has; the numbers that
``shape_msgs/SolidPrimitive`` gives them."""

_CONSTRAINTS = ("position", "orientation", "visibility")
"""Kinds of constraints that say nothing of joints."""


@dataclass(frozen=True, eq=False)
class SceneBody:
    """A shape of a collision object.

    Attributes:
        name: of the object.
        where: the shape, for messages.
        kind: a shape of obstacles, "cone", "mesh" or "plane".
        frame: in which its pose is.
        pose: of its centre; of a plane, or a mesh of a file of its own, no matter.
        dimensions: m, as of ``shape_msgs/SolidPrimitive``: height and radius of a cone.
        vertices: (V, 3) m, of a mesh.
        triangles: (F, 3), of a mesh.
    """

    name: str
    where: str
    kind: str
    frame: str
    pose: Pose
    dimensions: tuple[float, ...] = ()
    vertices: FloatArray | None = None
    triangles: IntArray | None = None

    def obstacle(self, base: Pose) -> Obstacle:
        """Return a body of a shape of obstacles as one, its frame put at a pose."""
        pose = base.then(self.pose)
        x, y, z = pose.position.tolist()
        a, b, c = REGISTRY[self.kind].of_dimensions(self.dimensions).tolist()
        return Obstacle(
            shape=self.kind, position=(x, y, z), quaternion=pose.quaternion, size=(a, b, c)
        )


@dataclass(frozen=True, eq=False)
class OrientationGoal:
    """An orientation of a link that a request asks for.

    Attributes:
        link: by name.
        frame: in which the rotation is.
        rotation: of the link.
        tolerances: (3,) rad, about x, y and z, not negative.
        euler: whether they are of the XYZ Euler angles of the difference; else of its rotation
            vector.
    """

    link: str
    frame: str
    rotation: Rotation
    tolerances: FloatArray
    euler: bool


@dataclass(frozen=True, eq=False)
class PoseGoal:
    """A place of a point of a link that a request asks for, with an orientation or without.

    Attributes:
        where: it stands, for messages.
        link: by name.
        point: (3,) m, in the link's frame.
        frame: in which the regions are.
        regions: "box" or "sphere", pose, and half extents (3,) m or radius (1,) m of each volume
            in which the point may be.
        orientation: None if it is free.
    """

    where: str
    link: str
    point: FloatArray
    frame: str
    regions: tuple[tuple[str, Pose, FloatArray], ...]
    orientation: OrientationGoal | None


def read_message(path: str | PathLike[str]) -> Mapping[str, Any]:
    """Return what a file holds, with the fields of the message.

    Args:
        path: of a text file, named ``.scene``, or else of one in YAML.

    Raises:
        OSError: the file cannot be read.
        ValueError: neither such a text nor a mapping in YAML.
        ImportError: it is YAML, and PyYAML is not installed.
    """
    file = Path(path)
    if file.suffix.lower() == ".scene":
        content = read_file(file, _LARGEST_TEXT)
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            raise ValueError(f"it is no text: {error}") from error
        return scene_message(text)
    require("motion-bench-maker", "reading MoveIt's YAML files")
    return as_mapping(parse_yaml(read_file(file), "it"), "the file")


def bodies_of(message: Mapping[str, Any]) -> Iterator[SceneBody]:
    """Yield the bodies of a scene in their order.

    Raises:
        ValueError: a field is wrong; the message names object, field and value.
    """
    items = as_list(_world(message).get("collision_objects"), "world.collision_objects")
    for number, entry in enumerate(items):
        item = as_mapping(entry, f"collision_objects[{number}]")
        yield from object_bodies(f"{item.get('id', number)!s}", item)


def frames_of(message: Mapping[str, Any]) -> dict[str, tuple[str, Pose]]:
    """Return the fixed frames of a scene: of each its parent, and its pose there.

    Raises:
        ValueError: a field is wrong, or a frame has two poses.
    """
    frames: dict[str, tuple[str, Pose]] = {}
    entries = as_list(message.get("fixed_frame_transforms"), "fixed_frame_transforms")
    for number, entry in enumerate(entries):
        where = f"fixed_frame_transforms[{number}]"
        item = as_mapping(entry, where)
        child, parent = frame_name(item.get("child_frame_id")), frame_in_header(item, where)
        pose = as_transform(item.get("transform"), f"{where}.transform")
        if child == parent:
            if not stays(pose):
                raise ValueError(f"{where} must not move the frame {child!r} in itself")
            continue
        if child in frames:
            raise ValueError(f"{where} must place another frame than those before, got {child!r}")
        frames[child] = parent, pose
    return frames


def joints_of(state: Any, where: str) -> dict[str, float]:
    """Return the positions, rad or m, of the joints of a ``moveit_msgs/RobotState`` by name.

    Raises:
        ValueError: a field is wrong, or a joint stands there twice.
    """
    state = as_mapping(state or {}, where)
    where = f"{where}.joint_state"
    entries = as_mapping(state.get("joint_state") or {}, where)
    pairs = named_values(entries, "name", "position", "position", where)
    return _joints([(name, as_number(value, f"{where}.position")) for name, value in pairs], where)


def base_moved(state: Any, where: str) -> str | None:
    """Return a joint of several degrees of freedom that a robot's state moves; None without.

    Raises:
        ValueError: a field is wrong.
    """
    state = as_mapping(state or {}, where)
    where = f"{where}.multi_dof_joint_state"
    entries = as_mapping(state.get("multi_dof_joint_state") or {}, where)
    pairs = named_values(entries, "joint_names", "transforms", "transform", where)
    for number, (name, entry) in enumerate(pairs):
        if not stays(as_transform(entry, f"{where}.transforms[{number}]")):
            return str(name)
    return None


def has_octomap(message: Mapping[str, Any]) -> bool:
    """Return whether a scene has an octomap in which something is."""
    octomap = _world(message).get("octomap")
    inner = octomap.get("octomap") if isinstance(octomap, Mapping) else None
    return bool(octomap) and not (isinstance(inner, Mapping) and not inner.get("data"))


def goals_of(message: Mapping[str, Any]) -> tuple[dict[str, float] | PoseGoal, ...]:
    """Return the goals of a request: of joints the positions, rad or m, by name, or of a link.

    Tolerances of joints are left alone: such a goal is the position itself. Weights are, too.

    Raises:
        ValueError: a field is wrong, or a goal is neither one of joints alone nor one of a link.
    """
    goals: list[dict[str, float] | PoseGoal] = []
    for number, entry in enumerate(as_list(message.get("goal_constraints"), "goal_constraints")):
        where = f"goal_constraints[{number}]"
        item = as_mapping(entry, where)
        kinds = [kind for kind in ("joint", *_CONSTRAINTS) if item.get(f"{kind}_constraints")]
        if "visibility" in kinds or ("joint" in kinds and len(kinds) > 1):
            raise ValueError(
                f"{where} has {kinds[-1]}_constraints, but only joint_constraints alone, or "
                "position_constraints with or without orientation_constraints, can be read"
            )
        if "position" in kinds or "orientation" in kinds:
            goals.append(_pose_goal(item, where))
            continue
        given = []
        where = f"{where}.joint_constraints"
        for index, constraint in enumerate(as_list(item.get("joint_constraints"), where)):
            fields = as_mapping(constraint, f"{where}[{index}]")
            position = as_number(fields.get("position"), f"{where}[{index}].position")
            given.append((fields.get("joint_name"), position))
        if not given:
            raise ValueError(f"{where} must hold at least one joint, got none")
        goals.append(_joints(given, where))
    return tuple(goals)


def _pose_goal(item: Mapping[str, Any], where: str) -> PoseGoal:
    """Return a goal of a link."""
    position = _only(item, "position_constraints", where)
    if position is None:
        raise ValueError(f"{where} has orientation_constraints, but no position_constraints")
    place = f"{where}.position_constraints[0]"
    offset = position.get("target_point_offset") or (0.0, 0.0, 0.0)
    orientation = _only(item, "orientation_constraints", where)
    return PoseGoal(
        where=where,
        link=_link(position, place),
        point=as_vector(offset, "xyz", f"{place}.target_point_offset"),
        frame=frame_in_header(position, place),
        regions=tuple(_regions(position.get("constraint_region"), f"{place}.constraint_region")),
        orientation=(
            None
            if orientation is None
            else _oriented(orientation, f"{where}.orientation_constraints[0]")
        ),
    )


def _only(item: Mapping[str, Any], field: str, where: str) -> Mapping[str, Any] | None:
    """Return the one constraint of a kind; None without."""
    entries = as_list(item.get(field), f"{where}.{field}")
    if len(entries) > 1:
        raise ValueError(f"{where}.{field} must hold one constraint, got {len(entries)}")
    return as_mapping(entries[0], f"{where}.{field}[0]") if entries else None


def _link(item: Mapping[str, Any], where: str) -> str:
    name = item.get("link_name")
    if not isinstance(name, str) or not name:
        raise ValueError(f"{where}.link_name must name a link, got {shown(name)}")
    return name


def _regions(value: Any, where: str) -> Iterator[tuple[str, Pose, FloatArray]]:
    """Yield the regions of a ``moveit_msgs/BoundingVolume``, as of `PoseGoal`."""
    volume = as_mapping(value, where)
    if volume.get("meshes"):
        raise ValueError(f"{where} has meshes, but only boxes and spheres can be read")
    primitives = as_list(volume.get("primitives"), f"{where}.primitives")
    if not primitives:
        raise ValueError(f"{where}.primitives must hold a box or a sphere, got none")
    poses = _poses(volume, "primitive", len(primitives), where)
    for index, (primitive, pose) in enumerate(zip(primitives, poses, strict=True)):
        kind, dimensions = _primitive(primitive, f"{where}.primitives[{index}]")
        if kind not in ("box", "sphere"):
            raise ValueError(f"{where}.primitives[{index}] must be a box or a sphere, got {kind!r}")
        yield kind, pose, np.array(dimensions) / (2.0 if kind == "box" else 1.0)


def _oriented(item: Mapping[str, Any], where: str) -> OrientationGoal:
    """Return what a ``moveit_msgs/OrientationConstraint`` asks for."""
    tolerances = [
        as_number(
            item.get(f"absolute_{axis}_axis_tolerance"), f"{where}.absolute_{axis}_axis_tolerance"
        )
        for axis in "xyz"
    ]
    if min(tolerances) < 0.0:
        raise ValueError(f"{where} must have tolerances of at least 0, got {tolerances}")
    meaning = item.get("parameterization", 0)
    if meaning not in (0, 1) or isinstance(meaning, bool):
        raise ValueError(f"{where}.parameterization must be 0 or 1, got {shown(meaning)}")
    if item.get("orientation") is None:
        raise ValueError(f"{where}.orientation must be given, got none")
    return OrientationGoal(
        link=_link(item, where),
        frame=frame_in_header(item, where),
        rotation=as_pose({"orientation": item["orientation"]}, where).rotation,
        tolerances=np.array(tolerances),
        euler=meaning == 0,
    )


def path_constrained(message: Mapping[str, Any]) -> bool:
    """Return whether a request constrains the path between start and goal."""
    path = message.get("path_constraints") or {}
    trajectory = message.get("trajectory_constraints") or {}
    kinds = [f"{kind}_constraints" for kind in ("joint", *_CONSTRAINTS)]
    constraints = as_mapping(path, "path_constraints")
    along = as_mapping(trajectory, "trajectory_constraints")
    return any(constraints.get(kind) for kind in kinds) or bool(along.get("constraints"))


def _joints(pairs: Sequence[tuple[Any, float]], where: str) -> dict[str, float]:
    found: dict[str, float] = {}
    for name, position in pairs:
        if not isinstance(name, str) or not name or name in found:
            raise ValueError(f"{where} must name each joint once, got {shown(name)}")
        found[name] = position
    return found


def _world(message: Mapping[str, Any]) -> Mapping[str, Any]:
    return as_mapping(message.get("world"), "world")


def object_bodies(name: str, item: Mapping[str, Any]) -> Iterator[SceneBody]:
    """Yield the bodies of a ``moveit_msgs/CollisionObject`` in their order.

    Raises:
        ValueError: a field is wrong; the message names object, field and value.
    """
    operation = str(item.get("operation", "add")).lower()
    if operation not in ("add", "append", "0", "2"):
        raise ValueError(f"{name}.operation must be 'add' or 'append', got {operation!r}")
    frame, given = frame_in_header(item, name), item.get("pose")
    own = as_pose(given, f"{name}.pose") if given else Pose.identity()
    primitives = as_list(item.get("primitives"), f"{name}.primitives")
    poses = _poses(item, "primitive", len(primitives), name)
    for index, (primitive, pose) in enumerate(zip(primitives, poses, strict=True)):
        where = f"{name}.primitives[{index}]"
        kind, dimensions = _primitive(primitive, where)
        yield SceneBody(name, where, kind, frame, own.then(pose), dimensions)
    meshes = [
        as_mapping(mesh, f"{name}.meshes[{index}]")
        for index, mesh in enumerate(as_list(item.get("meshes"), f"{name}.meshes"))
    ]
    # A mesh of another file has no place here, so that its pose does not matter.
    elsewhere = all(mesh.get("resource") for mesh in meshes)
    poses = [own] * len(meshes) if elsewhere else _poses(item, "mesh", len(meshes), name)
    for index, (mesh, pose) in enumerate(zip(meshes, poses, strict=True)):
        where = f"{name}.meshes[{index}]"
        vertices, triangles = (None, None) if mesh.get("resource") else _mesh(mesh, where)
        yield SceneBody(
            name, where, "mesh", frame, own.then(pose), vertices=vertices, triangles=triangles
        )
    for index, _ in enumerate(as_list(item.get("planes"), f"{name}.planes")):
        yield SceneBody(name, f"{name}.planes[{index}]", "plane", frame, own)


def _poses(item: Mapping[str, Any], kind: str, count: int, name: str) -> list[Pose]:
    """Return the poses of an object's shapes of one kind; all its own, if it has one alone."""
    field, kinds = f"{kind}_poses", "meshes" if kind == "mesh" else f"{kind}s"
    poses = as_list(item.get(field), f"{name}.{field}")
    if not poses and item.get("pose"):
        poses = [{}] * count
    if len(poses) != count:
        raise ValueError(
            f"{name} must have a pose for each of its {count} {kinds}, got {len(poses)}"
        )
    return [as_pose(given, f"{name}.{field}[{index}]") for index, given in enumerate(poses)]


def _primitive(primitive: Any, where: str) -> tuple[str, tuple[float, ...]]:
    """Return shape and dimensions, m, of a ``shape_msgs/SolidPrimitive``."""
    entries = as_mapping(primitive, where)
    kind = entries.get("type")
    shape = _NUMBERS.get(kind, kind) if isinstance(kind, int) else kind
    shape = shape.lower() if isinstance(shape, str) else shape
    if shape not in _DIMENSIONS:
        raise ValueError(f"{where}.type must be one of {', '.join(_DIMENSIONS)}; got {kind!r}")
    given = as_list(entries.get("dimensions"), f"{where}.dimensions")
    if len(given) != _DIMENSIONS[shape]:
        raise ValueError(
            f"{where}.dimensions of a {shape} must be {_DIMENSIONS[shape]} numbers, got "
            f"{list(given)}"
        )
    dimensions = [as_number(entry, f"{where}.dimensions") for entry in given]
    if min(dimensions) <= 0.0:
        raise ValueError(f"{where}.dimensions must be positive, got {dimensions}")
    return shape, tuple(dimensions)


def _mesh(mesh: Mapping[str, Any], where: str) -> tuple[FloatArray, IntArray]:
    """Return vertices (V, 3), m, and triangles (F, 3) of a ``shape_msgs/Mesh``."""
    points = as_list(mesh.get("vertices"), f"{where}.vertices")
    vertices = [as_vector(p, "xyz", f"{where}.vertices[{i}]") for i, p in enumerate(points)]
    entries = as_list(mesh.get("triangles"), f"{where}.triangles")
    triangles = [
        _corners(t, len(vertices), f"{where}.triangles[{i}]") for i, t in enumerate(entries)
    ]
    if not triangles:
        raise ValueError(f"{where} must have vertices and triangles, got none")
    return np.array(vertices), np.array(triangles, np.int64)


def _corners(triangle: Any, count: int, where: str) -> list[int]:
    """Return the numbers of three of `count` vertices."""
    given = triangle.get("vertex_indices") if isinstance(triangle, Mapping) else triangle
    corners = [] if isinstance(given, str) or not isinstance(given, Sequence) else list(given)
    if len(corners) != 3 or not all(type(i) is int and 0 <= i < count for i in corners):
        raise ValueError(
            f"{where} must be three of the {count} vertices by number, got {shown(triangle)}"
        )
    return corners
