"""Visual meshes of the JACO j2s6s200: lofts through measured cross-sections, as OBJ text.

They are for pictures only; physics and planning know the collision shapes and the spheres. The
cross-sections are data: `envs_assets/jaco_description/visuals.json`.
"""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np
import trimesh
from pydantic import TypeAdapter

from smp_gym.arrays import FloatArray, IntArray
from smp_gym.assets import asset_path

__all__ = ["Body", "Loft", "Plate", "obj", "visual_bodies"]
Row = tuple[float, float, float, float, float]

_AROUND = 24
"""Corners of a cross-section."""


@dataclass(frozen=True)
class Loft:
    """A body through superelliptic cross-sections along an axis of its frame.

    Attributes:
        axis: "y" or "z".
        rows: for each cross-section its place along the axis, the half width along x (it is
            symmetric), the lower and upper end along the third axis, all m, and the exponent of
            the superellipse: 2 is an ellipse, more is ever more of a rectangle.
    """

    axis: str
    rows: tuple[Row, ...]

    def sections(self) -> FloatArray:
        """Return the corners of all cross-sections, (rows, corners, 3)."""
        angle = 2 * np.pi * np.arange(_AROUND) / _AROUND
        place, width, low, high, exponent = np.array(self.rows).T[:, :, None]
        cos, sin = np.cos(angle), np.sin(angle)
        radius = (np.abs(cos) ** exponent + np.abs(sin) ** exponent) ** (-1 / exponent)
        x = width * radius * cos
        side = (low + high) / 2 + (high - low) / 2 * radius * sin
        along = np.broadcast_to(place, x.shape)
        return np.stack([x, along, side] if self.axis == "y" else [x, side, along], axis=-1)


@dataclass(frozen=True)
class Plate:
    """A plate with bevelled rims, its outline in the x-y plane.

    Attributes:
        outline: corners in order, counterclockwise, m.
        thickness: along z, m.
        bevel: m.
    """

    outline: tuple[tuple[float, float], ...]
    thickness: float
    bevel: float

    def sections(self) -> FloatArray:
        """Return the corners of all cross-sections, (4, corners, 3)."""
        outline = np.array(self.outline)
        tangent = np.roll(outline, -1, axis=0) - np.roll(outline, 1, axis=0)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        inner = outline + self.bevel * np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
        half = self.thickness / 2
        heights = (-half, self.bevel - half, half - self.bevel, half)
        return np.stack(
            [
                np.column_stack([corners, np.full(len(corners), height)])
                for corners, height in zip((inner, outline, outline, inner), heights, strict=True)
            ]
        )


Body = Loft | Plate


def visual_bodies() -> dict[str, Body]:
    """Return the bodies by name, each in the frame of the link (a ring: of the joint) it dresses.

    Raises:
        ValidationError: of pydantic; the packaged description names no such bodies.
    """
    bodies = json.loads(asset_path("jaco_description", "visuals.json").read_text())["bodies"]
    return TypeAdapter(dict[str, Body]).validate_python(bodies)


def obj(body: Body) -> str:
    """Return a body as the text of an OBJ file with smooth normals and flat ends."""
    sections = body.sections()
    rows, corners, _ = sections.shape
    wall = np.arange(rows * corners).reshape(rows, corners)
    following = np.roll(wall, -1, axis=1)
    quads = np.stack([wall[:-1], following[:-1], following[1:], wall[1:]], axis=-1).reshape(-1, 4)
    vertices = sections.reshape(-1, 3)
    if _volume(vertices, quads) < 0:
        quads = quads[:, ::-1]
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    mesh = trimesh.Trimesh(vertices, triangles, process=False)
    normals = np.array(mesh.vertex_normals)
    lines = _lines(vertices, normals, quads, 0)
    for section, inside in ((sections[0], sections[1]), (sections[-1], sections[-2])):
        lines += _cap(section, inside.mean(axis=0), sum(line.startswith("v ") for line in lines))
    return "\n".join(lines) + "\n"


def _volume(vertices: FloatArray, quads: IntArray) -> float:
    """Return the volume that quads enclose with the origin of their middle as the apex."""
    a, b, c, d = (vertices[quads[:, k]] - vertices.mean(axis=0) for k in range(4))
    return float((np.cross(b - a, d - a) * a).sum() + (np.cross(d - c, b - c) * c).sum())


def _cap(rim: FloatArray, inside: FloatArray, offset: int) -> list[str]:
    center = rim.mean(axis=0)
    normal = np.cross(rim[0] - center, rim[len(rim) // 4] - center)
    order = np.arange(len(rim))
    if normal @ (center - inside) < 0:
        normal, order = -normal, order[::-1]
    normal /= np.linalg.norm(normal)
    return _lines(rim, np.tile(normal, (len(rim), 1)), order[None], offset)


def _lines(vertices: FloatArray, normals: FloatArray, faces: IntArray, offset: int) -> list[str]:
    lines = [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in vertices + 0.0]
    lines += [f"vn {x:.2f} {y:.2f} {z:.2f}" for x, y, z in normals + 0.0]
    for face in (faces + offset + 1).tolist():
        lines.append("f " + " ".join(f"{corner}//{corner}" for corner in face))
    return lines
