"""Bodies of MoveIt's scenes as obstacles of the shapes that there are."""

from __future__ import annotations

import trimesh

from smp_gym.datasets.moveit_scene import SceneBody
from smp_gym.geometry.pose import Pose
from smp_gym.geometry.registry import REGISTRY
from smp_gym.scene import Obstacle
from smp_planner.library.covering import check_mesh
from smp_planner.library.mesh_obstacles import placed_spheres, spheres_of
from smp_planner.library.solids import cone_obstacles

__all__ = ["SKIPPING", "obstacles_of"]

SKIPPING = "skip_unsupported=True leaves it out"
"""Advice in messages on what cannot be used."""


def obstacles_of(
    body: SceneBody, frame: Pose, cell: float, overshoot: float, skip_unsupported: bool
) -> list[Obstacle]:
    """Return the obstacles that stand for a body.

    Args:
        body: of an object.
        frame: pose of the frame in which the body's is.
        cell: m, as of `PlanningScene.load`, like the rest.
        overshoot: m.
        skip_unsupported: whether to leave out planes, and meshes of other files.

    Raises:
        ValueError: a body that cannot be used; the message names it.
    """
    if body.kind in REGISTRY:
        return [body.obstacle(frame)]
    pose = frame.then(body.pose)
    if body.kind == "cone":
        height, radius = body.dimensions
        try:
            return cone_obstacles(
                radius,
                height,
                overshoot=overshoot,
                position=pose.position,
                quaternion=pose.quaternion,
            )
        except ValueError as error:
            raise ValueError(f"{body.where}: {error}") from error
    if body.vertices is not None:
        mesh = trimesh.Trimesh(body.vertices, body.triangles)
        check_mesh(mesh, body.where)
        spheres = spheres_of(mesh, cell, body.where, "if its lengths are millimetres, scale them")
        return placed_spheres(spheres, pose)
    if not skip_unsupported:
        what = "a plane" if body.kind == "plane" else "a mesh of another file"
        raise ValueError(f"{body.where} is {what}, which is not read; {SKIPPING}")
    return []
