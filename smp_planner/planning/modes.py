"""Homotopy classes of trajectories: signatures of paths among obstacles, and their groups.

In the plane, the winding numbers of paths with common ends around the obstacles tell their homology
classes apart, as the H-signature does, which is made of the same angles (Bhattacharya, Kumar &
Likhachev 2010, "Search-based path planning with homotopy class constraints"). In space there is no
such invariant: a path can be pulled over any bounded obstacle. `signatures_3d` is a convention.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import entr

from smp_gym.arrays import BoolArray, FloatArray, IntArray
from smp_gym.compiling import kernel

__all__ = ["Modes", "best_of_each", "group", "signatures_2d", "signatures_3d"]

_TOUCHING = 1e-9
"""Distance, over the extent of the paths, within which the side of a point is left to rounding."""


@dataclass(frozen=True)
class Modes:
    """N trajectories in C classes of equal signatures, the class of the largest share first.

    Attributes:
        signatures: (C, ...) of each class; of equal shares, the lower one comes first.
        labels: (N,) index of the class that each trajectory belongs to.
        shares: (C,) of the weight of all trajectories, sum 1.
    """

    signatures: IntArray
    labels: IntArray
    shares: FloatArray

    @property
    def count(self) -> int:
        """C, how many classes there are."""
        return len(self.shares)

    @property
    def members(self) -> tuple[IntArray, ...]:
        """Indices of the trajectories of each class, ascending."""
        return tuple(np.flatnonzero(self.labels == c) for c in range(self.count))

    @property
    def entropy(self) -> float:
        """-Σ p ln p of the shares, nats: 0 of one class, ln C of C equal ones."""
        return float(entr(self.shares).sum())


def group(signatures: ArrayLike, weights: ArrayLike | None = None) -> Modes:
    """Return the classes of trajectories with equal signatures.

    Args:
        signatures: (N, ...) integers, such as of `signatures_2d` or `signatures_3d`; N at least 1.
        weights: (N,) of the trajectories, not negative, of any positive sum; default equal.

    Raises:
        ValueError: no trajectory, signatures that are no integers, or weights of another shape, not
            finite, negative or all zero.
    """
    given = np.asarray(signatures)
    if given.ndim < 1 or len(given) == 0:
        raise ValueError(f"signatures must have shape (N, ...), N at least 1, got {given.shape}")
    if given.dtype.kind not in "iu" and given.size > 0:
        raise ValueError(f"signatures must be integers, got {given.dtype}")
    if weights is None:
        mass = np.ones(len(given))
    else:
        mass = _finite("weights", weights, (len(given),))
        if not ((mass >= 0.0).all() and mass.any()):
            raise ValueError(f"weights must not be negative nor all zero, got {mass}")
    _, first, labels = np.unique(
        given.reshape(len(given), -1), axis=0, return_index=True, return_inverse=True
    )
    # Some releases of numpy 2 return the inverse as a column.
    labels = labels.reshape(-1)
    shares = np.bincount(labels, mass) / mass.sum()
    order = np.argsort(-shares, kind="stable")
    return Modes(given[first[order]].astype(np.int64), np.argsort(order)[labels], shares[order])


def best_of_each(modes: Modes, costs: ArrayLike) -> IntArray:
    """Return (C,) indices of the cheapest trajectory of each class, the first of equal ones.

    Args:
        modes: classes of N trajectories.
        costs: (N,); inf for one that is taken only where its class has nothing but such.

    Raises:
        ValueError: costs of another shape, or nan.
    """
    values = np.asarray(costs, np.float64)
    if values.shape != modes.labels.shape:
        raise ValueError(f"costs must have shape {modes.labels.shape}, got {values.shape}")
    if np.isnan(values).any():
        raise ValueError(f"costs must not be nan, got {values}")
    return np.array([m[values[m].argmin()] for m in modes.members], np.int64)


def signatures_2d(paths: ArrayLike, centers: ArrayLike) -> IntArray:
    """Return (N, M) winding numbers of paths around obstacles, relative to the straight connection.

    For each obstacle: the angle that a path sweeps around its centre, less the angle that the
    straight connection of the ends sweeps, in turns, counter-clockwise positive. So 0 is to pass
    the obstacle on the same side as the straight connection does, +1 or -1 on the other side, more
    to turn around it. The straight connection of a centre that lies on it is taken to have it on
    its left; then 0 is to have it on the left, and -1 on the right. A path reversed has the
    negative number, and -1 less that number where the centre lies on the straight connection.

    Paths between samples are straight. The straight connection is that of the mean start and the
    mean end of all N paths, to which each path is joined by straight pieces: so ends may differ
    a little, by less than their distance from any centre, and signatures of different calls are
    comparable only if the mean ends are the same.

    Paths of one homotopy class have equal signatures. The converse holds for one obstacle; around
    several, paths that turn around one, then another, and back in the same order, are not told from
    those that do not (the signature is that of homology).

    Args:
        paths: (N, T, 2), N at least 1, T at least 2.
        centers: (M, 2), a point of each obstacle, in the unit of the paths; M may be 0.

    Raises:
        ValueError: arrays of other shapes or not finite, or a path that passes through a centre or
            is joined to the mean ends through one, where there is no winding number.
    """
    points = _paths(paths, 2)
    middles = _finite("centers", centers, (None, 2))
    result = np.empty((len(points), len(middles)), np.int64)
    for m, center in enumerate(middles):
        result[:, m], undefined = _windings(points, center)
        _refuse(undefined, m, center)
    return result


def signatures_3d(
    paths: ArrayLike,
    centers: ArrayLike,
    half_heights: ArrayLike,
    radii: ArrayLike = np.inf,
    axis: ArrayLike = (0.0, 0.0, 1.0),
) -> IntArray:
    """Return (N, M, 2) for each path and obstacle (winding, level): beside it, over it or under it.

    The place where a path comes nearest to the line of the obstacle's axis decides (the first of
    equally near ones). If it is nearer to the line than the obstacle's radius, and beyond its half
    height, the path passes over the obstacle, (0, 1), or under it, (0, -1). Otherwise it passes
    beside it, (w, 0), where w is the winding number of `signatures_2d` of the path projected along
    the axis, counter-clockwise as seen from the axis' tip.

    This is a convention and not an invariant: all paths with common ends around bounded obstacles
    can be deformed into one another, and a path that is moved over an edge of the obstacle changes
    its signature there although it touches nothing. With the default radii, all that is higher
    is over, however far aside.

    Args:
        paths: (N, T, 3), m, N at least 1, T at least 2.
        centers: (M, 3), m, of the obstacles; M may be 0.
        half_heights: (M,) or one for all, m along the axis, not negative.
        radii: (M,) or one for all, m across the axis, positive; inf allowed.
        axis: (M, 3) or one (3,) for all, of any length but 0; the default is vertical.

    Raises:
        ValueError: arrays of other shapes, values out of the ranges above, or a path that passes
            beside an obstacle but meets its axis there, or whose projection is joined to the mean
            ends through it.
    """
    points = _paths(paths, 3)
    middles = _finite("centers", centers, (None, 3))
    count = len(middles)
    heights = _for_each("half_heights", half_heights, (count,))
    if not (np.isfinite(heights) & (heights >= 0.0)).all():
        raise ValueError(f"half_heights must be finite and not negative, got {heights}")
    widths = _for_each("radii", radii, (count,))
    if not (widths > 0.0).all():
        raise ValueError(f"radii must be positive, got {widths}")
    axes = _for_each("axis", axis, (count, 3))
    lengths = np.linalg.norm(axes, axis=-1, keepdims=True)
    if not (np.isfinite(lengths) & (lengths > 0.0)).all():
        raise ValueError(f"axis must be finite and not zero, got {axes}")
    result = np.empty((len(points), count, 2), np.int64)
    planes: dict[tuple[float, ...], FloatArray] = {}
    for m, (center, direction) in enumerate(zip(middles, axes / lengths, strict=True)):
        key = tuple(direction.tolist())
        plane = planes[key] = planes[key] if key in planes else _plane(direction)
        across, along = points @ plane, (points - center) @ direction
        middle = center @ plane
        distance, height = _nearest_approach(across - middle, along)
        level = np.where(np.abs(height) > heights[m], np.sign(height), 0.0)
        level[distance >= widths[m]] = 0.0
        winding, undefined = _windings(across, middle)
        _refuse(undefined & (level == 0.0), m, center)
        result[:, m, 0] = np.where(level == 0.0, winding, 0)
        result[:, m, 1] = level
    return result


def _windings(paths: FloatArray, center: FloatArray) -> tuple[IntArray, BoolArray]:
    """Return (N,) winding numbers of (N, T, 2), and (N,) where they are undefined."""
    start, end = (np.broadcast_to(paths[:, t].mean(0), paths[:, t].shape) for t in (0, -1))
    joined = np.concatenate([start[:, None], paths, end[:, None]], axis=1) - center
    touching = _TOUCHING * max(np.ptp(joined[..., 0]), np.ptp(joined[..., 1]))
    swept, distance, _, _ = _passed(joined)
    straight, from_straight, _, _ = _passed(np.ascontiguousarray(joined[:1, [0, -1]]))
    turned = straight[0]
    if from_straight[0] <= touching:
        turned = abs(turned)
    turns = (swept - turned) / (2.0 * np.pi)
    return np.rint(turns).astype(np.int64), distance <= touching


@kernel
def _passed(points):  # type: ignore[no-untyped-def]
    """Return how each of the paths (N, T, 2) passes the origin.

    Returns:
        (N,) rad, the angle that it sweeps; (N,) its least distance; the (first) edge on which that
        is, and where on it, in [0, 1].
    """
    count, samples = points.shape[:2]
    swept, least = np.zeros(count), np.full(count, np.inf)
    edge, share = np.zeros(count, np.int64), np.zeros(count)
    for n in range(count):
        for t in range(samples - 1):
            x, y = points[n, t, 0], points[n, t, 1]
            u, v = points[n, t + 1, 0], points[n, t + 1, 1]
            swept[n] += math.atan2(x * v - y * u, x * u + y * v)
            along_x, along_y = u - x, v - y
            square = along_x * along_x + along_y * along_y
            part = 0.0
            if square > 0.0:
                part = min(max(-(x * along_x + y * along_y) / square, 0.0), 1.0)
            distance = math.hypot(x + part * along_x, y + part * along_y)
            if distance < least[n]:
                least[n], edge[n], share[n] = distance, t, part
    return swept, least, edge, share


def _nearest_approach(across: FloatArray, along: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (N,) distances of (N, T, 2) from the origin where least, and `along` (N, T) there."""
    _, distance, edge, share = _passed(np.ascontiguousarray(across))
    each = np.arange(len(across))
    return distance, (1.0 - share) * along[each, edge] + share * along[each, edge + 1]


def _plane(direction: FloatArray) -> FloatArray:
    """Return (3, 2), two unit vectors that make a right-handed frame with a third."""
    first = np.cross(np.eye(3)[np.abs(direction).argmin()], direction)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(direction, first)], axis=1)


def _refuse(undefined: BoolArray, m: int, center: FloatArray) -> None:
    if undefined.any():
        raise ValueError(
            f"paths must not pass through a centre: paths[{undefined.argmax()}], or what joins its"
            f" ends to the mean ends, passes through centers[{m}] = {center}"
        )


def _finite(name: str, value: ArrayLike, shape: tuple[int | None, ...]) -> FloatArray:
    array = np.asarray(value, np.float64)
    matches = array.ndim == len(shape) and all(
        allowed in (None, size) for allowed, size in zip(shape, array.shape, strict=True)
    )
    if not matches:
        expected = tuple("any" if size is None else size for size in shape)
        raise ValueError(f"{name} must have shape {expected}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite, got {array}")
    return array


def _paths(paths: ArrayLike, dimensions: int) -> FloatArray:
    points = _finite("paths", paths, (None, None, dimensions))
    if points.shape[0] < 1 or points.shape[1] < 2:
        raise ValueError(
            f"paths must be one or more of two points or more, got shape {points.shape}"
        )
    return points


def _for_each(name: str, value: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    array = np.asarray(value, np.float64)
    if array.shape not in (shape, shape[1:]):
        raise ValueError(f"{name} must have shape {shape} or {shape[1:]}, got {array.shape}")
    return np.broadcast_to(array, shape)
