"""A robot from its URDF: the chain of moving joints to a tip, its limits, spheres around its links.

The chain of `RobotModel` turns about the z axes of its frames; a joint with another axis gets a
frame that is turned so. Its base frame is that of the URDF's root link. Metres and radians.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from smp_gym.arrays import FloatArray
from smp_gym.geometry.registry import REGISTRY
from smp_gym.robot.kinematics import SphereSet
from smp_planner.collision.robot_model import RobotModel
from smp_planner.library.covering import cover_mesh

__all__ = ["CONTINUOUS_LIMIT", "Robot"]

CONTINUOUS_LIMIT = 4.0 * math.pi
"""rad in either direction, limits of a continuous joint for which the URDF names none."""


@dataclass(frozen=True)
class _Joint:
    """A joint of a URDF, as far as geometry and limits go."""

    name: str
    kind: str
    parent: str
    child: str
    origin: FloatArray
    axis: FloatArray
    lower: float
    upper: float
    velocity: float
    is_mimic: bool

    @property
    def is_fixed(self) -> bool:
        return self.kind == "fixed"

    def held_at(self, position: float) -> FloatArray:
        """Return the pose (4, 4) of the child in the parent at a position, rad or m."""
        pose = np.eye(4)
        if self.kind in ("revolute", "continuous"):
            pose[:3, :3] = Rotation.from_rotvec(position * self.axis).as_matrix()
        elif self.kind == "prismatic":
            pose[:3, 3] = position * self.axis
        return np.asarray(self.origin @ pose)


@dataclass(frozen=True, eq=False)
class Robot:
    """A serial chain of revolute joints with spheres around its links.

    Made by `Robot.from_urdf`.

    Attributes:
        model: the chain; its `collision_pairs` are left to `SMP.fit`, which sees from the
            demonstrations what may come near to what.
        joints: (n) names of its joints, in the order of a configuration's coordinates.
    """

    model: RobotModel
    joints: tuple[str, ...]

    @classmethod
    def from_urdf(
        cls,
        path: str | Path,
        tip: str,
        *,
        held: Mapping[str, float] | None = None,
        cell: float = 0.06,
    ) -> Robot:
        """Read the chain from the root link to a tip.

        What hangs on the chain beside it, such as fingers, moves with the link that it hangs on.

        Args:
            path: the file; meshes are found relative to it, `package://` names among the
                folders above it.
            tip: link whose origin is the tool.
            held: joints that stand still, and where (rad or m). Joints beside the chain that are
                not named stand at 0, or at the limit that is nearest to it.
            cell: m, size of the pieces of a collision shape that each get a sphere.

        Raises:
            FileNotFoundError: no such file, or a mesh is missing.
            ValueError: not a URDF, no such link or joint, no moving joint on the chain, or a
                joint of the chain that is neither revolute, continuous, fixed nor held.
        """
        file = Path(path)
        try:
            root = ET.fromstring(file.read_bytes())
        except ET.ParseError as error:
            raise ValueError(f"{file} is not a URDF: {error}") from error
        if root.tag != "robot":
            raise ValueError(f"{file} is not a URDF: its root is <{root.tag}>, not <robot>")
        links = {link.get("name", ""): link for link in root.findall("link")}
        joints = [_read_joint(element) for element in root.findall("joint")]
        for joint in joints:
            for end in (joint.parent, joint.child):
                if end not in links:
                    raise ValueError(
                        f"joint {joint.name!r} names the link {end!r}, which is not there"
                    )
        if tip not in links:
            raise ValueError(f"tip must be one of {', '.join(links)}; got {tip!r}")
        held = dict(held or {})
        unknown = set(held) - {joint.name for joint in joints}
        if unknown:
            raise ValueError(f"held names joints that {file} lacks: {', '.join(sorted(unknown))}")
        chain = _moving_chain(joints, tip, held)
        return _assembled(file, links, joints, chain, tip, held, cell)

    @property
    def dimension(self) -> int:
        """Number of joints n."""
        return len(self.joints)

    def tool_positions(self, configurations: FloatArray) -> FloatArray:
        """Return where the tool is, (..., 3) m, in configurations (..., n) rad."""
        return self.model.carried_points(configurations, np.zeros(3))[0]


def _numbers(text: str | None, default: str) -> FloatArray:
    return np.array([float(word) for word in (text or default).split()])


def _origin(element: ET.Element | None) -> FloatArray:
    pose = np.eye(4)
    if element is not None:
        pose[:3, :3] = Rotation.from_euler("xyz", _numbers(element.get("rpy"), "0 0 0")).as_matrix()
        pose[:3, 3] = _numbers(element.get("xyz"), "0 0 0")
    return pose


def _read_joint(element: ET.Element) -> _Joint:
    def link(tag: str) -> str:
        found = element.find(tag)
        return "" if found is None else found.get("link", "")

    axis = element.find("axis")
    direction = _numbers(None if axis is None else axis.get("xyz"), "1 0 0")
    kind, limit = element.get("type", ""), element.find("limit")
    limits = {} if limit is None else limit.attrib
    name = element.get("name", "")
    length = float(np.linalg.norm(direction))
    if kind != "fixed" and not length > 0.0:
        raise ValueError(f"joint {name!r} must have an axis that is not zero, got {direction}")
    endless = kind == "continuous"
    return _Joint(
        name=name,
        kind=kind,
        parent=link("parent"),
        child=link("child"),
        origin=_origin(element.find("origin")),
        axis=direction / (length or 1.0),
        lower=float(limits.get("lower", -CONTINUOUS_LIMIT if endless else 0.0)),
        upper=float(limits.get("upper", CONTINUOUS_LIMIT if endless else 0.0)),
        velocity=float(limits.get("velocity", 0.0)),
        is_mimic=element.find("mimic") is not None,
    )


def _moving_chain(
    joints: Sequence[_Joint], tip: str, held: Mapping[str, float]
) -> tuple[_Joint, ...]:
    """Return the joints from the root to a tip that move."""
    above = {joint.child: joint for joint in joints}
    chain, link = [], tip
    while link in above:
        joint = above.pop(link)
        chain.append(joint)
        link = joint.parent
    moving = tuple(j for j in reversed(chain) if not j.is_fixed and j.name not in held)
    for joint in moving:
        if joint.kind not in ("revolute", "continuous") or joint.is_mimic:
            kind = "mimic" if joint.is_mimic else joint.kind
            raise ValueError(
                f"joint {joint.name!r} in the chain to {tip!r} is {kind}; only revolute and "
                f"continuous joints can be planned for, others must be held"
            )
        if not joint.lower < joint.upper or not joint.velocity > 0.0:
            raise ValueError(
                f"joint {joint.name!r} must have a range and a velocity limit, got "
                f"[{joint.lower}, {joint.upper}] rad and {joint.velocity} rad/s"
            )
    if not moving:
        raise ValueError(f"tip {tip!r} must be moved by at least one joint, got none")
    return moving


def _assembled(
    file: Path,
    links: Mapping[str, ET.Element],
    joints: Sequence[_Joint],
    chain: tuple[_Joint, ...],
    tip: str,
    held: Mapping[str, float],
    cell: float,
) -> Robot:
    children = {joint.child for joint in joints}
    roots = [name for name in links if name not in children]
    if len(roots) != 1:
        raise ValueError(f"{file} must have one root link, got {roots}")
    # Of each link, the moving one that it is fixed to, and its pose there.
    placed: dict[str, tuple[int, FloatArray]] = {roots[0]: (0, np.eye(4))}
    origins = np.empty((len(chain), 4, 4))
    waiting = [roots[0]]
    while waiting:
        parent = waiting.pop()
        index, pose = placed[parent]
        for joint in joints:
            if joint.parent != parent:
                continue
            if joint in chain:
                number = chain.index(joint)
                turn = np.eye(4)
                turn[:3, :3] = _turning_z_to(joint.axis)
                origins[number] = pose @ joint.origin @ turn
                placed[joint.child] = number + 1, turn.T
            else:
                at = held.get(joint.name, min(max(0.0, joint.lower), joint.upper))
                placed[joint.child] = index, pose @ joint.held_at(at)
            waiting.append(joint.child)
    if len(placed) != len(links):
        apart = ", ".join(sorted(set(links) - set(placed)))
        raise ValueError(f"{file} has links that are not joined to its root: {apart}")
    link, spheres = [], []
    for name, (index, pose) in placed.items():
        for sphere in _link_spheres(file, links[name], cell):
            link.append(index)
            spheres.append([*(pose[:3, :3] @ sphere[:3] + pose[:3, 3]), sphere[3]])
    data = np.array(spheres).reshape(-1, 4)
    model = RobotModel(
        base=np.eye(4),
        joint_origins=origins,
        end_effector=placed[tip][1],
        lower=np.array([joint.lower for joint in chain]),
        upper=np.array([joint.upper for joint in chain]),
        velocity=np.array([joint.velocity for joint in chain]),
        spheres=SphereSet(np.array(link, np.int64), data[:, :3], data[:, 3]),
        collision_pairs=np.empty((0, 2), np.int64),
    )
    return Robot(model, tuple(joint.name for joint in chain))


def _turning_z_to(axis: FloatArray) -> FloatArray:
    """Return a rotation (3, 3) that takes the z axis to a unit vector."""
    return np.asarray(Rotation.align_vectors(axis[None], [[0.0, 0.0, 1.0]])[0].as_matrix())


def _link_spheres(file: Path, link: ET.Element, cell: float) -> Iterator[FloatArray]:
    """Yield spheres (4,) that cover the collision shapes of a link, in its frame."""
    for collision in link.findall("collision"):
        geometry = collision.find("geometry")
        if geometry is None or not len(geometry):
            raise ValueError(f"a collision of link {link.get('name')!r} has no geometry")
        pose = _origin(collision.find("origin"))
        for sphere in _covering(file, geometry[0], cell):
            yield np.array([*(pose[:3, :3] @ sphere[:3] + pose[:3, 3]), sphere[3]])


def _covering(file: Path, shape: ET.Element, cell: float) -> FloatArray:
    if shape.tag == "mesh":
        mesh = trimesh.load(_mesh_file(file, shape.get("filename", "")), force="mesh")
        mesh.apply_transform(np.diag([*_numbers(shape.get("scale"), "1 1 1"), 1.0]))
        return cover_mesh(mesh, cell)
    given = {
        "box": _numbers(shape.get("size"), "0 0 0").tolist(),
        "cylinder": [float(shape.get("length", 0)), float(shape.get("radius", 0))],
        "sphere": [float(shape.get("radius", 0))],
    }
    if shape.tag not in given:
        raise ValueError(f"geometry must be box, cylinder, sphere or mesh, got <{shape.tag}>")
    kind = REGISTRY[shape.tag]
    return kind.cover(kind.of_dimensions(given[shape.tag]), cell)


def _mesh_file(file: Path, name: str) -> Path:
    """Return where a mesh is that a URDF names."""
    within = name.partition("://")[2] if "://" in name else name
    for folder in file.resolve().parents:
        if (folder / within).is_file():
            return folder / within
    raise FileNotFoundError(
        f"{file} names the mesh {name!r}, which is not found beside or above it"
    )
