"""Measures of a set of paths in the plane: clearance, homotopy classes, similarity."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from smp_gym.arrays import FloatArray, IntArray
from smp_planner.benchmark import metrics
from smp_planner.library.shapes import Circle
from smp_planner.planning.modes import signatures_2d

__all__ = ["classes", "clearances", "diversity", "similarity"]

_SIMILARITY = ("wasserstein", "frechet", "mmd")


def clearances(paths: FloatArray, circles: Sequence[Circle]) -> FloatArray:
    """Return (P,) the least distance of each path from the circles, negative where it enters one.

    Paths (P, T, 2) are straight between samples, and the distance is exact for those. Without any
    circle it is inf.
    """
    least = np.full(len(paths), np.inf)
    start, edge = paths[:, :-1], np.diff(paths, axis=1)
    squares = np.maximum(np.square(edge).sum(axis=-1), np.finfo(np.float64).tiny)
    for circle in circles:
        offset = start - np.asarray(circle.center)
        share = np.clip(-(offset * edge).sum(axis=-1) / squares, 0.0, 1.0)
        nearest = np.linalg.norm(offset + share[..., None] * edge, axis=-1).min(axis=1)
        least = np.minimum(least, nearest - circle.radius)
    return least


def classes(paths: FloatArray, circles: Sequence[Circle], ends: FloatArray) -> IntArray:
    """Return (P, M) winding numbers of paths around circles, comparable between sets of paths.

    Args:
        paths: (P, T, 2).
        circles: M of them.
        ends: (2, 2) common start and end that all paths are joined to by straight pieces.

    Raises:
        ValueError: as `modes.signatures_2d`.
    """
    joined = np.empty((len(paths), paths.shape[1] + 2, 2))
    joined[:, 0], joined[:, 1:-1], joined[:, -1] = ends[0], paths, ends[1]
    centers = np.array([circle.center for circle in circles]).reshape(-1, 2)
    return signatures_2d(joined, centers)


def similarity(paths: FloatArray, reference: FloatArray) -> dict[str, float | None]:
    """Return wasserstein, frechet and mmd of `metrics.compare`; None of an empty set.

    Args:
        paths: (P, T, 2).
        reference: (R, U, 2).
    """
    if not len(paths):
        return dict.fromkeys(_SIMILARITY)
    found = metrics.compare(paths, reference)
    return {name: float(getattr(found, name)) for name in _SIMILARITY}


def diversity(paths: FloatArray) -> float:
    """Return the mean distance of two paths of a set, by `metrics.rms_distances`; 0 of one path."""
    count = len(paths)
    if count < 2:
        return 0.0
    return float(metrics.rms_distances(paths, paths).sum() / (count * (count - 1)))
