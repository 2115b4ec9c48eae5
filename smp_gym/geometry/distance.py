"""Exact signed distance to bodies of all shapes, for any orientation.

The distance to a set of bodies is the minimum over the bodies: exact outside them, and inside where
they do not overlap; where they do, the depth below the common surface is at least the one returned.

The kernels take the arrays of `PackedObstacles` and are meant to be called from other compiled
kernels; they check nothing. `signed_distance` is the checked door.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from smp_gym.arrays import FloatArray
from smp_gym.compiling import kernel
from smp_gym.geometry import registry
from smp_gym.geometry.registry import REGISTRY, SHAPES

if TYPE_CHECKING:
    from smp_gym.scene import Obstacle

__all__ = [
    "PackedObstacles",
    "check_points",
    "local_distance",
    "point_distance",
    "point_distance_and_gradient",
    "signed_distance",
    "signed_distance_and_gradient",
    "to_local",
]

_body_distance, _body_gradient = registry.distance, registry.gradient


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
        bound = np.array([float(REGISTRY[o.shape].bound(np.array(o.size))) for o in obstacles])
        return cls(shape, _rotations_to_body(quaternion), position, size, bound)

    def __len__(self) -> int:
        return len(self.shape)

    @property
    def half_extents(self) -> FloatArray:
        """(N, 3) m, half-extents along the base frame's axes of boxes around the bodies."""
        boxes = [
            REGISTRY[SHAPES[shape]].half_extents(rotation.T, size)
            for shape, rotation, size in zip(self.shape, self.rotation, self.size, strict=True)
        ]
        return np.array(boxes).reshape(-1, 3)

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
def _local_distances(points, shape, sizes):  # type: ignore[no-untyped-def]
    result = np.empty(len(points))
    for i in range(len(points)):
        result[i] = _body_distance(shape, points[i, 0], points[i, 1], points[i, 2], sizes[i])
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
        distance = _body_distance(shape[i], a, b, c, size[i])
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
    ga, gb, gc = _body_gradient(shape[i], a, b, c, size[i])
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
