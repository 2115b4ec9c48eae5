"""The mesh of a robot's link, `LinkMesh`, as a viewer shows it."""

from __future__ import annotations

from typing import NamedTuple

from smp_gym.arrays import FloatArray, IntArray

__all__ = ["LinkMesh"]


class LinkMesh(NamedTuple):
    """Triangles that are fixed to a link.

    Attributes:
        link: its number in `RobotModel`; 0 does not move.
        vertices: (V, 3) m in the link's frame.
        faces: (F, 3) indices of vertices.
    """

    link: int
    vertices: FloatArray
    faces: IntArray
