"""The links of a robot as triangles, to be shown: from what its URDF has to be seen."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh

from smp_gym.assets import jaco_urdf
from smp_planner.collision.robot_model import jaco_model
from smp_planner.library.covering import read_mesh
from smp_planner.library.urdf_reading import Shape
from smp_planner.planning.link_mesh import LinkMesh

if TYPE_CHECKING:
    from smp_planner.library.urdf import Robot

__all__ = ["jaco_meshes", "link_meshes"]

_FINGERS = 0.6
"""rad, at which the fingers of the arm of the tasks are shown: half closed."""


def link_meshes(robot: Robot) -> list[LinkMesh]:
    """Return a mesh of each link of a robot that has something to be seen.

    Args:
        robot: from its URDF; one that was loaded from a file of `SMP.save` has none.

    Raises:
        ValueError: a file of a mesh is damaged.
        OSError: it is no longer there.
    """
    found: dict[int, list[Any]] = {}
    for link, shape in robot.visuals:
        found.setdefault(link, []).append(_body(shape, link))
    meshes = []
    for link, bodies in sorted(found.items()):
        whole: Any = trimesh.util.concatenate(bodies)
        meshes.append(
            LinkMesh(link, np.asarray(whole.vertices, np.float64), np.asarray(whole.faces))
        )
    return meshes


@cache
def jaco_meshes(pen: bool = False) -> Sequence[LinkMesh]:
    """Return a mesh of each link of the arm of the tasks, its fingers half closed.

    Args:
        pen: whether it holds the pen.
    """
    from smp_planner.library.urdf import Robot

    robot = Robot.from_urdf(
        jaco_urdf(pen=pen), "j2s6s200_end_effector", held=_fingers(pen), overshoot=0.1
    )
    base, *moving = link_meshes(robot)
    # Link 0 of a robot from a URDF is the root; that of the arm's model is turned.
    turned = base.vertices @ jaco_model().base[:3, :3]
    return (base._replace(vertices=turned), *moving)


def _fingers(pen: bool) -> dict[str, float]:
    return {} if pen else {f"j2s6s200_joint_finger_{number}": _FINGERS for number in (1, 2)}


def _body(shape: Shape, link: int) -> Any:
    """Return a shape as a `trimesh.Trimesh` in the frame of its link."""
    size = shape.size.tolist()
    if shape.kind == "mesh":
        assert shape.mesh is not None
        mesh = read_mesh(shape.mesh, shape.size, f"the mesh {shape.mesh} of link {link}")
    elif shape.kind == "box":
        mesh = trimesh.creation.box(extents=size)
    elif shape.kind == "cylinder":
        mesh = trimesh.creation.cylinder(height=size[0], radius=size[1], sections=32)
    elif shape.kind == "capsule":
        mesh = trimesh.creation.capsule(height=size[0], radius=size[1])
    else:
        mesh = trimesh.creation.icosphere(subdivisions=3, radius=size[0])
    mesh.apply_transform(shape.origin)
    return mesh
