"""Lines drawn into pictures: they show what has no body, and leave physics and snapshots alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smp_gym.arrays import FloatArray

__all__ = ["Line", "draw_lines", "wire_box"]

_SUBDIVISION = 16
_DEPTH_SLACK = 1e-4
"""Steps between two points of a line; what rounding may take from its depth."""

_WIRE = (0, 1, 2, 3, 0, 4, 5, 1, 5, 6, 2, 6, 7, 3, 7, 4)
"""Corners of a box in an order that passes all edges."""


@dataclass(frozen=True, eq=False)
class Line:
    """A line through points in space.

    Attributes:
        points: (M, 3) m.
        color: red, green, blue, each 0 to 1.
        width: share of the picture's height.
        hidden: whether bodies hide what is behind them.
    """

    points: FloatArray
    color: tuple[float, float, float]
    width: float
    hidden: bool = True


def wire_box(position: Sequence[float], size: Sequence[float]) -> FloatArray:
    """Return points (16, 3) m of a line along all edges of an upright box.

    Args:
        position: (3,) m, its centre.
        size: (3,) m, its half-extents.
    """
    around = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    corners = np.vstack([np.insert(around, 2, side, axis=1) for side in (-1, 1)])
    points: FloatArray = np.asarray(position) + corners[list(_WIRE)] * np.asarray(size)
    return points


def draw_lines(
    image: NDArray[np.uint8], depth: NDArray[Any], matrix: FloatArray, lines: Sequence[Line]
) -> None:
    """Draw lines into an image; bodies that are nearer hide them, if they can be hidden.

    Args:
        image: (H, W, 4), changed in place.
        depth: (H, W), 0 at the near plane, 1 at the far plane.
        matrix: (4, 4) from homogeneous points to the clip space of OpenGL.
        lines: with less than two points they are not drawn.
    """
    for line in lines:
        if len(line.points) > 1:
            _draw(image, depth, matrix, line)


def _draw(image: NDArray[np.uint8], depth: NDArray[Any], matrix: FloatArray, line: Line) -> None:
    height, width = depth.shape
    ends = np.column_stack([line.points, np.ones(len(line.points))]) @ matrix.T
    share = np.linspace(0.0, 1.0, _SUBDIVISION, endpoint=False)[:, None]
    points = (ends[:-1, None] + share * (ends[1:, None] - ends[:-1, None])).reshape(-1, 4)
    points = points[points[:, 3] > 0.0]
    place = points[:, :3] / points[:, 3:]
    column = np.rint((place[:, 0] + 1.0) / 2 * width - 0.5).astype(np.int64)
    row = np.rint((1.0 - place[:, 1]) / 2 * height - 0.5).astype(np.int64)
    near = (place[:, 2] + 1.0) / 2
    color = np.rint(255 * np.array(line.color)).astype(np.uint8)
    # A brush of an odd number of pixels has a middle.
    half = round((height * line.width - 1) / 2)
    for down in range(-half, half + 1):
        for right in range(-half, half + 1):
            r, c = row + down, column + right
            seen = (r >= 0) & (r < height) & (c >= 0) & (c < width)
            r, c = r[seen], c[seen]
            front = near[seen] <= (depth[r, c] + _DEPTH_SLACK if line.hidden else 1.0)
            image[r[front], c[front], :3] = color
