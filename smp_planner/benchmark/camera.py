"""A still camera for 3-D scenes: faces and lines painted from far to near on flat axes.

Matplotlib's own 3-D axes sort whole objects, so that a path in front of one obstacle and behind
another cannot be drawn; here every small piece is sorted by its own depth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb

from smp_gym.arrays import FloatArray
from smp_gym.geometry.faces import body_faces
from smp_gym.scene import Obstacle

__all__ = ["Camera", "Painter"]

_LIGHT = np.array([0.45, -0.25, 0.86])
_ROUND = 40
_PIECE = 0.02
_BORDER = 0.03


@dataclass(frozen=True)
class Camera:
    """A perspective camera directed at a point.

    Attributes:
        target: (3,) m, in the middle of the picture.
        azimuth: degrees from x towards y, under which the camera stands as seen from the target.
        elevation: degrees above the horizontal.
        distance: from the target, m.
    """

    target: tuple[float, float, float]
    azimuth: float
    elevation: float
    distance: float

    def _axes(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        azimuth, elevation = np.deg2rad([self.azimuth, self.elevation])
        back = np.array(
            [
                np.cos(elevation) * np.cos(azimuth),
                np.cos(elevation) * np.sin(azimuth),
                np.sin(elevation),
            ]
        )
        right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        return right, np.cross(back, right), back

    @property
    def position(self) -> FloatArray:
        """(3,) m."""
        return np.array(self.target) + self.distance * self._axes()[2]

    def project(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return picture coordinates (..., 2), in metres at the target, and depths (...), m."""
        right, up, back = self._axes()
        offset = np.asarray(points, np.float64) - np.array(self.target)
        depth = self.distance - offset @ back
        flat = np.stack([offset @ right, offset @ up], axis=-1)
        return flat * (self.distance / depth)[..., None], depth


def _normal(face: FloatArray, inside: FloatArray) -> FloatArray:
    """Return the unit normal of a face that points away from a point inside its body."""
    normal = np.cross(face[2] - face[0], face[3] - face[1])
    length = np.linalg.norm(normal)
    if length == 0.0:
        return np.zeros(3)
    return normal / length * np.sign(normal @ (face.mean(axis=0) - inside))


class Painter:
    """Collects pieces of a scene and paints them from far to near.

    Args:
        camera: from where the scene is seen.
    """

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        self._pieces: list[tuple[float, FloatArray, Any, Any, float]] = []

    def _add(self, points: FloatArray, face: Any, edge: Any, width: float, depth: float) -> None:
        flat, depths = self.camera.project(points)
        self._pieces.append((depth or float(depths.mean()), flat, face, edge, width))

    def body(self, body: Obstacle, color: str, alpha: float = 1.0) -> None:
        """Add the faces of a convex body that face the camera, lit from above."""
        centre = np.array(body.position)
        for face in body_faces(body):
            normal = _normal(face, centre)
            if normal @ (self.camera.position - face.mean(axis=0)) <= 0.0:
                continue
            light = 0.72 + 0.28 * float(normal @ _LIGHT)
            shade = (*np.clip(np.array(to_rgb(color)) * light, 0.0, 1.0), alpha)
            # Edges in the colour of the face close the seams between neighbours.
            self._add(face, shade, shade if alpha == 1.0 else "none", 0.5, 0.0)

    def flat(self, polygon: FloatArray, color: Any, edge: Any = "none") -> None:
        """Add a polygon (V, 3) that lies under everything else, above earlier ones."""
        below = 1e6 - len(self._pieces)
        self._add(polygon, color, edge, 0.6, below)

    def flat_line(self, points: FloatArray, color: Any, width: float) -> None:
        """Add a line (N, 3) that lies under everything else, above earlier ones."""
        self._add(points, "none", color, width, 1e6 - len(self._pieces))

    def line(
        self,
        points: FloatArray,
        color: Any,
        width: float,
        *,
        dashed: bool = False,
        nearer: float = 0.0,
    ) -> None:
        """Add a line (N, 3), cut into short pieces; `nearer` (m) moves it towards the camera."""
        along = np.concatenate([[0.0], np.linalg.norm(np.diff(points, axis=0), axis=1).cumsum()])
        count = max(2, int(np.ceil(along[-1] / _PIECE)) + 1)
        at = np.linspace(0.0, along[-1], 3 * (count - 1) + 1)
        fine = np.stack([np.interp(at, along, column) for column in points.T], axis=1)
        for i in range(0, len(fine) - 1, 3):
            if not dashed or (i // 3) % 2 == 0:
                piece = fine[i : i + 4]
                depth = float(self.camera.project(piece)[1].mean()) - nearer
                self._add(piece, "none", color, width, depth)

    def paint(self, axes: Any) -> None:
        """Paint all pieces on flat axes, and fit the axes to them."""
        pieces = sorted(self._pieces, key=lambda piece: -piece[0])
        outlines = [
            np.concatenate([flat, flat[::-1]]) if face == "none" else flat
            for _, flat, face, _, _ in pieces
        ]
        axes.add_collection(
            PolyCollection(
                outlines,
                facecolors=[piece[2] for piece in pieces],
                edgecolors=[piece[3] for piece in pieces],
                linewidths=[piece[4] for piece in pieces],
                capstyle="round",
                joinstyle="round",
            )
        )
        everything = np.concatenate(outlines)
        low, high = everything.min(axis=0), everything.max(axis=0)
        axes.set(
            xlim=(low[0] - _BORDER, high[0] + _BORDER),
            ylim=(low[1] - _BORDER, high[1] + _BORDER),
        )
        axes.set_aspect("equal")
        axes.set_axis_off()
