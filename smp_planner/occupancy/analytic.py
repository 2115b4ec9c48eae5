"""Exact signed distance of boxes, cylinders and spheres, for any orientation.

The distance to a set of bodies is the minimum over the bodies: exact outside them, and inside where
they do not overlap; where they do, the depth below the common surface is at least the one returned.

The kernels take the arrays of `PackedObstacles` and are meant to be called from other compiled
kernels; they check nothing. `signed_distance` is the checked door.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from smp_gym.compiling import kernel
from smp_gym.scene import SHAPES, Obstacle
from smp_planner.occupancy.occupancy_map import TRUNCATION, window

__all__ = [
    "AnalyticMap",
    "PackedObstacles",
    "local_distance",
    "point_distance",
    "point_distance_and_gradient",
    "signed_distance",
    "signed_distance_and_gradient",
    "to_local",
]

FloatArray = NDArray[np.float64]

_BOX = SHAPES.index("box")
_CYLINDER = SHAPES.index("cylinder")


@dataclass(frozen=True)
class PackedObstacles:
    """N obstacles as contiguous arrays, for compiled kernels.

    Attributes:
        shape: (N,) int64, index into `smp_gym.scene.SHAPES`.
        rotation: (N, 3, 3), from the base frame to the body's: local = rotation @ (p - position).
        position: (N, 3) m, centres.
        size: (N, 3) m, half-extents as in `Obstacle.size`.
        bound: (N,) m, radius of the bounding ball about the centre.
    """

    shape: NDArray[np.int64]
    rotation: FloatArray
    position: FloatArray
    size: FloatArray
    bound: FloatArray

    @classmethod
    def of(cls, obstacles: Sequence[Obstacle]) -> PackedObstacles:
        """Pack obstacles in their order; none give arrays of length 0."""
        shape = np.array([SHAPES.index(o.shape) for o in obstacles], np.int64)
        quaternion = np.array([o.quaternion for o in obstacles], np.float64).reshape(-1, 4)
        position = np.array([o.position for o in obstacles], np.float64).reshape(-1, 3)
        size = np.array([o.size for o in obstacles], np.float64).reshape(-1, 3)
        bound = np.where(
            shape == _BOX,
            np.linalg.norm(size, axis=1),
            np.where(shape == _CYLINDER, np.hypot(size[:, 0], size[:, 2]), size[:, 0]),
        )
        return cls(shape, _rotations_to_body(quaternion), position, size, bound)

    def __len__(self) -> int:
        return len(self.shape)

    @property
    def half_extents(self) -> FloatArray:
        """(N, 3) m, half-extents along the base frame's axes of boxes around the bodies."""
        return np.einsum("nij,ni->nj", np.abs(self.rotation), self.size)

    @property
    def arrays(
        self,
    ) -> tuple[NDArray[np.int64], FloatArray, FloatArray, FloatArray, FloatArray]:
        """The five arrays in the order in which `point_distance` takes them."""
        return self.shape, self.rotation, self.position, self.size, self.bound


def _rotations_to_body(quaternion: FloatArray) -> FloatArray:
    """Return (N, 3, 3) rotations from base to body of (N, 4) quaternions x, y, z, w."""
    if not len(quaternion):
        return np.empty((0, 3, 3))
    turns: FloatArray = Rotation.from_quat(quaternion).as_matrix()
    return np.ascontiguousarray(turns.swapaxes(1, 2))


@kernel
def to_local(x, y, z, rotation, position):  # type: ignore[no-untyped-def]
    """Return a point (m, base frame) in the frame of one packed body."""
    dx, dy, dz = x - position[0], y - position[1], z - position[2]
    return (
        rotation[0, 0] * dx + rotation[0, 1] * dy + rotation[0, 2] * dz,
        rotation[1, 0] * dx + rotation[1, 1] * dy + rotation[1, 2] * dz,
        rotation[2, 0] * dx + rotation[2, 1] * dy + rotation[2, 2] * dz,
    )


@kernel
def _body_distance(a, b, c, shape, size):  # type: ignore[no-untyped-def]
    """Signed distance of one body to the point (a, b, c) of its own frame."""
    if shape == _BOX:
        u, v, w = abs(a) - size[0], abs(b) - size[1], abs(c) - size[2]
        outside = math.sqrt(max(u, 0.0) ** 2 + max(v, 0.0) ** 2 + max(w, 0.0) ** 2)
        return outside + min(max(u, v, w), 0.0)
    if shape == _CYLINDER:
        u, v = math.sqrt(a * a + b * b) - size[0], abs(c) - size[2]
        return math.sqrt(max(u, 0.0) ** 2 + max(v, 0.0) ** 2) + min(max(u, v), 0.0)
    return math.sqrt(a * a + b * b + c * c) - size[0]


@kernel
def _local_distances(points, shape, sizes):  # type: ignore[no-untyped-def]
    result = np.empty(len(points))
    for i in range(len(points)):
        result[i] = _body_distance(points[i, 0], points[i, 1], points[i, 2], shape, sizes[i])
    return result


def local_distance(points: FloatArray, shape: str, sizes: FloatArray) -> FloatArray:
    """Return the signed distance of each point to a body of its own.

    Args:
        points: (N, 3) m, each in the frame of its body.
        shape: one of `smp_gym.scene.SHAPES`.
        sizes: (N, 3) m, half-extents of the bodies, as in `Obstacle.size`.

    Returns:
        (N,) m, negative inside.
    """
    return np.asarray(_local_distances(points, SHAPES.index(shape), sizes), np.float64)


@kernel
def _nearest(x, y, z, shape, rotation, position, size, bound):  # type: ignore[no-untyped-def]
    """Distance to the nearest body, and its index (-1 if there is none)."""
    best, index = np.inf, -1
    for i in range(len(shape)):
        dx, dy, dz = x - position[i, 0], y - position[i, 1], z - position[i, 2]
        horizon = best + bound[i]
        if horizon < 0.0 or dx * dx + dy * dy + dz * dz >= horizon * horizon:
            continue
        a, b, c = to_local(x, y, z, rotation[i], position[i])
        distance = _body_distance(a, b, c, shape[i], size[i])
        if distance < best:
            best, index = distance, i
    return best, index


@kernel
def point_distance(x, y, z, shape, rotation, position, size, bound):  # type: ignore[no-untyped-def]
    """Return the signed distance of one point (m) to packed obstacles; infinity if there is none.

    The last five arguments are `PackedObstacles.arrays`.
    """
    return _nearest(x, y, z, shape, rotation, position, size, bound)[0]


@kernel
def _body_gradient(a, b, c, shape, size):  # type: ignore[no-untyped-def]
    """Gradient of `_body_distance`, a unit vector in the body's frame.

    On edges of the distance's graph (its medial axis) one of the one-sided gradients is returned.
    """
    if shape == _BOX:
        u, v, w = abs(a) - size[0], abs(b) - size[1], abs(c) - size[2]
        gu, gv, gw = max(u, 0.0), max(v, 0.0), max(w, 0.0)
        norm = math.sqrt(gu * gu + gv * gv + gw * gw)
        if norm > 0.0:
            gu, gv, gw = gu / norm, gv / norm, gw / norm
        elif u >= v and u >= w:
            gu = 1.0
        elif v >= w:
            gv = 1.0
        else:
            gw = 1.0
        return math.copysign(gu, a), math.copysign(gv, b), math.copysign(gw, c)
    if shape == _CYLINDER:
        rho = math.sqrt(a * a + b * b)
        u, v = rho - size[0], abs(c) - size[2]
        gu, gv = max(u, 0.0), max(v, 0.0)
        norm = math.sqrt(gu * gu + gv * gv)
        if norm > 0.0:
            gu, gv = gu / norm, gv / norm
        elif u >= v:
            gu = 1.0
        else:
            gv = 1.0
        ex, ey = (a / rho, b / rho) if rho > 0.0 else (1.0, 0.0)
        return gu * ex, gu * ey, math.copysign(gv, c)
    norm = math.sqrt(a * a + b * b + c * c)
    if norm > 0.0:
        return a / norm, b / norm, c / norm
    return 1.0, 0.0, 0.0


@kernel
def point_distance_and_gradient(  # type: ignore[no-untyped-def]
    x, y, z, shape, rotation, position, size, bound
):
    """Return (distance, gx, gy, gz) of one point: m, and a unit vector away from the nearest body.

    Without obstacles it is (infinity, 0, 0, 0). The last five arguments are
    `PackedObstacles.arrays`.
    """
    distance, i = _nearest(x, y, z, shape, rotation, position, size, bound)
    if i < 0:
        return distance, 0.0, 0.0, 0.0
    a, b, c = to_local(x, y, z, rotation[i], position[i])
    ga, gb, gc = _body_gradient(a, b, c, shape[i], size[i])
    r = rotation[i]
    return (
        distance,
        r[0, 0] * ga + r[1, 0] * gb + r[2, 0] * gc,
        r[0, 1] * ga + r[1, 1] * gb + r[2, 1] * gc,
        r[0, 2] * ga + r[1, 2] * gb + r[2, 2] * gc,
    )


@kernel
def _distances(points, shape, rotation, position, size, bound):  # type: ignore[no-untyped-def]
    result = np.empty(len(points))
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        result[i] = point_distance(x, y, z, shape, rotation, position, size, bound)
    return result


@kernel
def _distances_and_gradients(  # type: ignore[no-untyped-def]
    points, shape, rotation, position, size, bound
):
    distance, gradient = np.empty(len(points)), np.empty((len(points), 3))
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        d, gx, gy, gz = point_distance_and_gradient(x, y, z, shape, rotation, position, size, bound)
        distance[i] = d
        gradient[i, 0], gradient[i, 1], gradient[i, 2] = gx, gy, gz
    return distance, gradient


def check_points(points: ArrayLike) -> FloatArray:
    """Return points as a float64 array.

    Raises:
        ValueError: the last axis is not of length 3, or a coordinate is not finite.
    """
    array = np.ascontiguousarray(points, np.float64)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise ValueError(f"points must have shape (..., 3), got {array.shape}")
    if not np.isfinite(array).all():
        bad = array.reshape(-1, 3)[~np.isfinite(array.reshape(-1, 3)).all(axis=1)][0]
        raise ValueError(f"points must be finite, got {bad}")
    return array


def _packed(obstacles: Sequence[Obstacle] | PackedObstacles) -> PackedObstacles:
    return obstacles if isinstance(obstacles, PackedObstacles) else PackedObstacles.of(obstacles)


def signed_distance(
    points: ArrayLike, obstacles: Sequence[Obstacle] | PackedObstacles
) -> FloatArray:
    """Return the signed distance of points to the nearest obstacle.

    Args:
        points: (..., 3) m, base frame.
        obstacles: bodies at the pose they have now (velocities are not used).

    Returns:
        (...) m, negative inside; infinity everywhere if there is no obstacle.

    Raises:
        ValueError: `points` has the wrong shape or is not finite.
    """
    array = check_points(points)
    result = _distances(array.reshape(-1, 3), *_packed(obstacles).arrays)
    return result.reshape(array.shape[:-1])


def signed_distance_and_gradient(
    points: ArrayLike, obstacles: Sequence[Obstacle] | PackedObstacles
) -> tuple[FloatArray, FloatArray]:
    """Return the signed distance and its gradient with respect to the point.

    Args:
        points: (..., 3) m, base frame.
        obstacles: bodies at the pose they have now.

    Returns:
        (...) m and (..., 3); the gradient has unit length (zero if there is no obstacle) and points
        away from the nearest body.

    Raises:
        ValueError: `points` has the wrong shape or is not finite.
    """
    array = check_points(points)
    distance, gradient = _distances_and_gradients(array.reshape(-1, 3), *_packed(obstacles).arrays)
    return distance.reshape(array.shape[:-1]), gradient.reshape(array.shape)


@kernel
def _fill(values, origin, spacing, truncation, half_extents, shape, rotation, position, size):  # type: ignore[no-untyped-def]
    for n in range(len(shape)):
        reach = half_extents[n] + truncation
        center = position[n]
        i0, i1 = window(values.shape[0], origin[0], spacing, center[0], reach[0])
        j0, j1 = window(values.shape[1], origin[1], spacing, center[1], reach[1])
        k0, k1 = window(values.shape[2], origin[2], spacing, center[2], reach[2])
        for i in range(i0, i1):
            x = origin[0] + spacing * i
            for j in range(j0, j1):
                y = origin[1] + spacing * j
                for k in range(k0, k1):
                    a, b, c = to_local(x, y, origin[2] + spacing * k, rotation[n], center)
                    d = max(_body_distance(a, b, c, shape[n], size[n]), -truncation)
                    if d < values[i, j, k]:
                        values[i, j, k] = d


@dataclass(frozen=True)
class AnalyticMap:
    """The exact map, an `OccupancyMap`.

    Attributes:
        obstacles: bodies at the pose they have now; may be empty.
        truncation: m, largest absolute value of the distance.
    """

    obstacles: tuple[Obstacle, ...]
    truncation: float = TRUNCATION

    def __post_init__(self) -> None:
        if not (math.isfinite(self.truncation) and self.truncation > 0.0):
            raise ValueError(f"AnalyticMap.truncation must be positive, got {self.truncation}")

    def signed_distance(self, points: ArrayLike) -> FloatArray:
        """Return the truncated signed distance; see `OccupancyMap.signed_distance`."""
        distance = signed_distance(points, self.obstacles)
        return np.clip(distance, -self.truncation, self.truncation)

    def fill(self, values: NDArray[np.float32], origin: FloatArray, spacing: float) -> None:
        """Lower the nodes of a grid to the exact distance; see `OccupancyMap.fill`."""
        packed = PackedObstacles.of(self.obstacles)
        shape, rotation, position, size, _ = packed.arrays
        extents = packed.half_extents
        truncation = self.truncation
        _fill(values, origin, spacing, truncation, extents, shape, rotation, position, size)
