"""Visual meshes of the JACO j2s6s200: lofts through measured cross-sections, as OBJ text.

They are for pictures only; physics and planning know the collision shapes and the spheres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
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


_ARM_HALF: tuple[Row, ...] = (
    (0.0408, 0.0121, -0.0280, 0.0, 3.8),
    (0.0383, 0.0183, -0.0317, 0.0, 3.5),
    (0.0330, 0.0266, -0.0355, 0.0, 3.4),
    (0.0247, 0.0339, -0.0391, 0.0, 3.3),
    (0.0144, 0.0391, -0.0417, 0.0, 3.3),
    (0.0, 0.0412, -0.0427, 0.0, 3.6),
    (-0.0250, 0.0404, -0.0429, 0.0, 2.6),
    (-0.0408, 0.0394, -0.0430, 0.0, 2.0),
    (-0.0415, 0.0396, -0.0430, -0.0135, 2.2),
    (-0.0600, 0.0386, -0.0427, -0.0138, 2.0),
    (-0.0800, 0.0376, -0.0420, -0.0119, 2.0),
    (-0.1100, 0.0361, -0.0408, -0.0083, 2.0),
    (-0.1500, 0.0341, -0.0394, -0.0043, 2.0),
    (-0.2050, 0.0334, -0.0384, -0.0025, 2.0),
)
"""The upper arm is symmetric about its middle, 0.205 m from either joint."""

_SMALL_RING = Loft(
    "z",
    tuple(
        (z, r, -r, r, 2.0)
        for z, r in (
            (-0.0097, 0.0318),
            (-0.0092, 0.0333),
            (-0.0078, 0.0339),
            (0.0078, 0.0339),
            (0.0092, 0.0333),
            (0.0097, 0.0318),
        )
    ),
)
_BIG_RING = Loft(
    "z",
    tuple(
        (z, r, -r, r, 2.0)
        for z, r in (
            (-0.0115, 0.0415),
            (-0.0109, 0.0438),
            (-0.0092, 0.0445),
            (0.0092, 0.0445),
            (0.0109, 0.0438),
            (0.0115, 0.0415),
        )
    ),
)

BODIES: dict[str, Body] = {
    "base": Loft(
        "z",
        (
            (0.0, 0.0318, -0.0360, 0.0318, 2.8),
            (0.0100, 0.0360, -0.0398, 0.0360, 2.7),
            (0.0240, 0.0376, -0.0412, 0.0376, 2.6),
            (0.0330, 0.0392, -0.0412, 0.0392, 2.3),
            (0.0400, 0.0412, -0.0412, 0.0412, 2.0),
            (0.0620, 0.0412, -0.0412, 0.0412, 2.0),
            (0.0670, 0.0411, -0.0412, 0.0370, 2.2),
            (0.0750, 0.0408, -0.0412, 0.0350, 2.2),
            (0.0950, 0.0402, -0.0412, 0.0350, 2.2),
            (0.1150, 0.0406, -0.0412, 0.0350, 2.2),
            (0.1230, 0.0409, -0.0412, 0.0370, 2.2),
            (0.1280, 0.0412, -0.0412, 0.0410, 2.0),
            (0.1567, 0.0412, -0.0412, 0.0412, 2.0),
        ),
    ),
    "shoulder": Loft(
        "z",
        (
            (0.0, 0.0412, -0.0412, 0.0412, 2.0),
            (-0.0230, 0.0411, -0.0412, 0.0410, 2.0),
            (-0.0340, 0.0403, -0.0410, 0.0379, 2.0),
            (-0.0430, 0.0390, -0.0405, 0.0298, 2.0),
            (-0.0500, 0.0380, -0.0399, 0.0188, 2.0),
            (-0.0560, 0.0374, -0.0394, 0.0081, 2.0),
            (-0.0620, 0.0370, -0.0390, -0.0019, 2.0),
            (-0.0700, 0.0372, -0.0388, -0.0099, 2.1),
            (-0.0768, 0.0376, -0.0388, -0.0107, 2.2),
            (-0.0776, 0.0377, -0.0388, 0.0016, 2.8),
            (-0.0900, 0.0391, -0.0391, 0.0016, 3.2),
            (-0.1188, 0.0412, -0.0411, 0.0016, 4.0),
            (-0.1332, 0.0390, -0.0413, 0.0016, 4.0),
            (-0.1435, 0.0339, -0.0408, 0.0016, 3.9),
            (-0.1517, 0.0264, -0.0387, 0.0016, 3.7),
            (-0.1571, 0.0181, -0.0347, 0.0016, 3.7),
            (-0.1596, 0.0115, -0.0302, 0.0016, 3.7),
        ),
    ),
    "arm": Loft(
        "y",
        _ARM_HALF + tuple((-0.41 - row[0], *row[1:]) for row in _ARM_HALF[-2::-1]),
    ),
    "forearm": Loft(
        "y",
        (
            (-0.0408, 0.0125, -0.0291, 0.0, 3.9),
            (-0.0383, 0.0185, -0.0324, 0.0, 3.7),
            (-0.0330, 0.0265, -0.0372, 0.0, 3.5),
            (-0.0247, 0.0339, -0.0412, 0.0, 3.4),
            (-0.0144, 0.0391, -0.0428, 0.0, 3.6),
            (0.0, 0.0412, -0.0429, 0.0, 4.0),
            (0.0250, 0.0404, -0.0417, 0.0, 2.6),
            (0.0408, 0.0383, -0.0402, 0.0, 2.0),
            (0.0415, 0.0384, -0.0401, -0.0132, 2.2),
            (0.0600, 0.0350, -0.0380, -0.0138, 2.0),
            (0.0800, 0.0321, -0.0358, -0.0111, 2.0),
            (0.0950, 0.0300, -0.0347, -0.0080, 2.0),
            (0.1100, 0.0285, -0.0346, -0.0037, 2.0),
            (0.1250, 0.0279, -0.0355, 0.0012, 2.0),
            (0.1400, 0.0281, -0.0372, 0.0064, 2.0),
            (0.1550, 0.0291, -0.0391, 0.0116, 2.0),
            (0.1700, 0.0304, -0.0411, 0.0167, 2.0),
            (0.1850, 0.0313, -0.0425, 0.0196, 2.0),
            (0.2072, 0.0315, -0.0429, 0.0201, 2.0),
        ),
    ),
    "wrist_1": Loft(
        "z",
        (
            (0.0, 0.0315, -0.0315, 0.0315, 2.0),
            (-0.0240, 0.0314, -0.0315, 0.0316, 2.0),
            (-0.0340, 0.0306, -0.0303, 0.0321, 2.0),
            (-0.0400, 0.0296, -0.0254, 0.0330, 2.0),
            (-0.0460, 0.0284, -0.0152, 0.0342, 2.0),
            (-0.0520, 0.0273, -0.0038, 0.0360, 2.1),
            (-0.0600, 0.0264, 0.0083, 0.0391, 2.1),
            (-0.0713, 0.0270, 0.0121, 0.0434, 2.2),
            (-0.0720, 0.0271, 0.0001, 0.0436, 2.6),
            (-0.0900, 0.0296, 0.0001, 0.0471, 3.4),
            (-0.1037, 0.0315, 0.0001, 0.0475, 3.5),
            (-0.1148, 0.0300, 0.0001, 0.0467, 3.4),
            (-0.1226, 0.0262, 0.0001, 0.0449, 3.5),
            (-0.1290, 0.0205, 0.0001, 0.0420, 3.6),
            (-0.1330, 0.0144, 0.0001, 0.0384, 3.6),
            (-0.1350, 0.0098, 0.0001, 0.0346, 3.7),
        ),
    ),
    "wrist_2": Loft(
        "y",
        (
            (-0.0312, 0.0104, -0.0348, 0.0, 3.6),
            (-0.0293, 0.0147, -0.0385, 0.0, 3.6),
            (-0.0252, 0.0206, -0.0419, 0.0, 3.7),
            (-0.0189, 0.0262, -0.0449, 0.0, 3.5),
            (-0.0110, 0.0300, -0.0466, 0.0, 3.4),
            (0.0, 0.0315, -0.0474, 0.0, 3.5),
            (0.0150, 0.0294, -0.0468, 0.0, 3.4),
            (0.0315, 0.0271, -0.0435, 0.0, 2.6),
            (0.0322, 0.0270, -0.0432, -0.0120, 2.2),
            (0.0400, 0.0264, -0.0404, -0.0115, 2.1),
            (0.0460, 0.0266, -0.0379, -0.0050, 2.1),
            (0.0520, 0.0274, -0.0357, 0.0047, 2.1),
            (0.0580, 0.0285, -0.0340, 0.0161, 2.0),
            (0.0640, 0.0297, -0.0328, 0.0259, 2.0),
            (0.0710, 0.0307, -0.0319, 0.0307, 2.0),
            (0.0800, 0.0314, -0.0315, 0.0316, 2.0),
            (0.1036, 0.0315, -0.0315, 0.0316, 2.0),
        ),
    ),
    "hand": Loft(
        "z",
        (
            (0.0, 0.0315, -0.0315, 0.0315, 2.0),
            (-0.0180, 0.0315, -0.0318, 0.0318, 2.0),
            (-0.0250, 0.0308, -0.0329, 0.0329, 2.0),
            (-0.0350, 0.0282, -0.0370, 0.0370, 2.2),
            (-0.0450, 0.0248, -0.0421, 0.0421, 2.6),
            (-0.0550, 0.0236, -0.0472, 0.0472, 2.9),
            (-0.0650, 0.0236, -0.0515, 0.0515, 3.2),
            (-0.0750, 0.0237, -0.0541, 0.0541, 3.2),
            (-0.0820, 0.0240, -0.0541, 0.0541, 3.0),
            (-0.0880, 0.0246, -0.0515, 0.0515, 2.8),
            (-0.0960, 0.0250, -0.0440, 0.0440, 2.8),
            (-0.1030, 0.0248, -0.0375, 0.0375, 3.0),
            (-0.1090, 0.0240, -0.0365, 0.0365, 3.0),
            (-0.1160, 0.0220, -0.0350, 0.0350, 3.0),
            (-0.1195, 0.0180, -0.0310, 0.0310, 3.0),
        ),
    ),
    "finger": Plate(
        (
            (-0.0072, 0.0),
            (-0.0050, -0.0060),
            (-0.0010, -0.0155),
            (0.0018, -0.0208),
            (0.0070, -0.0207),
            (0.0200, -0.0200),
            (0.0300, -0.0195),
            (0.0366, -0.0188),
            (0.0420, -0.0150),
            (0.0480, -0.0100),
            (0.0504, -0.0050),
            (0.0494, -0.0008),
            (0.0465, 0.0018),
            (0.0425, 0.0024),
            (0.0350, 0.0018),
            (0.0250, 0.0004),
            (0.0180, 0.0002),
            (0.0110, 0.0012),
            (0.0060, 0.0032),
            (0.0030, 0.0048),
            (-0.0005, 0.0052),
            (-0.0045, 0.0040),
        ),
        0.0225,
        0.0022,
    ),
    "fingertip": Plate(
        (
            (-0.0085, -0.0035),
            (-0.0094, -0.0095),
            (-0.0078, -0.0132),
            (-0.0030, -0.0145),
            (0.0030, -0.0140),
            (0.0120, -0.0120),
            (0.0220, -0.0105),
            (0.0330, -0.0092),
            (0.0400, -0.0083),
            (0.0428, -0.0072),
            (0.0437, -0.0045),
            (0.0425, -0.0026),
            (0.0370, -0.0008),
            (0.0310, 0.0002),
            (0.0250, 0.0002),
            (0.0190, 0.0020),
            (0.0120, 0.0044),
            (0.0070, 0.0055),
            (-0.0020, 0.0055),
            (-0.0060, 0.0030),
        ),
        0.0222,
        0.0020,
    ),
    "ring_big": _BIG_RING,
    "ring_small": _SMALL_RING,
}
"""Bodies by name, each in the frame of the link (or, for the rings, of the joint) it dresses."""
