"""Ranking of particles: feasibility comes first, then the density under the prior."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from smp_gym.arrays import BoolArray, FloatArray

__all__ = ["SAFE_CLEARANCE", "demanded_and_merit", "rank"]

SAFE_CLEARANCE = 0.01
"""Clearance, m (or extents), beyond which more of it makes a particle no better."""


def demanded_and_merit(
    free: BoolArray,
    passing: BoolArray,
    executable: BoolArray,
    clearance: FloatArray,
    missed: Mapping[str, FloatArray],
    costs: Mapping[str, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Return what particles are put in order by, (P,) and, among equals, (P,); higher is better.

    Args: as of `rank`.
    """
    demanded = 4.0 * free + 2.0 * passing + 1.0 * executable
    unsafe = np.where(free, np.maximum(SAFE_CLEARANCE - clearance, 0.0), -clearance)
    dissimilarity = costs["prior"] if "prior" in costs else costs["length"]
    # One unit of the prior is worth a tenth of a millimetre of missing clearance.
    merit = -dissimilarity - 1e4 * unsafe
    for value in missed.values():
        merit = merit - 1e3 * value
    return demanded, merit


def rank(
    free: BoolArray,
    passing: BoolArray,
    executable: BoolArray,
    clearance: FloatArray,
    missed: Mapping[str, FloatArray],
    costs: Mapping[str, FloatArray],
) -> NDArray[np.int64]:
    """Return the place (P,) of each particle, the best having 0.

    First come those that satisfy more of what is demanded: free of collisions, then meeting all
    constraints, then executable. Among equals the merit decides, the log-prior less penalties for
    what is missing of `SAFE_CLEARANCE` and of the constraints.

    Args:
        free: (P,) whether collision-free.
        passing: (P,) whether all constraints are met.
        executable: (P,) whether limits hold.
        clearance: (P,) m (or extents).
        missed: by how much (P,) each constraint is missed, same unit.
        costs: (P,) by name; `prior` counts, and where there is none, `length`.
    """
    demanded, merit = demanded_and_merit(free, passing, executable, clearance, missed, costs)
    order = np.lexsort((merit, demanded))[::-1]
    places = np.empty(len(order), np.int64)
    places[order] = np.arange(len(order))
    return places
