"""Ranking of particles: feasibility comes first, then the density under the prior."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smp_gym.arrays import BoolArray, FloatArray

__all__ = ["SAFE_CLEARANCE", "Merits", "demanded_and_merit", "rank"]

SAFE_CLEARANCE = 0.01
"""Clearance, m (or extents), beyond which more of it makes a particle no better."""


@dataclass(frozen=True, eq=False)
class Merits:
    """What P particles are put in order by.

    Attributes:
        free: (P,) whether collision-free.
        passing: (P,) whether all constraints are met.
        executable: (P,) whether limits hold.
        clearance: (P,) m (or extents).
        missed: by how much (P,) each constraint is missed, same unit.
        costs: (P,) by name; `prior` counts, and where there is none, `length`.
        bonus: (P,) added to the merit, in units of the log-prior.
    """

    free: BoolArray
    passing: BoolArray
    executable: BoolArray
    clearance: FloatArray
    missed: Mapping[str, FloatArray]
    costs: Mapping[str, FloatArray]
    bonus: FloatArray | float = 0.0


def demanded_and_merit(merits: Merits) -> tuple[FloatArray, FloatArray]:
    """Return how much of what is demanded particles satisfy, (P,), and their merit (P,).

    They are put in order by the first, and among equals by the second; higher is better. See
    `rank`.
    """
    demanded = 4.0 * merits.free + 2.0 * merits.passing + 1.0 * merits.executable
    missing = np.maximum(SAFE_CLEARANCE - merits.clearance, 0.0)
    unsafe = np.where(merits.free, missing, -merits.clearance)
    costs = merits.costs
    dissimilarity = costs["prior"] if "prior" in costs else costs["length"]
    # One unit of the prior is worth a tenth of a millimetre of missing clearance.
    merit = -dissimilarity - 1e4 * unsafe + merits.bonus
    for value in merits.missed.values():
        merit = merit - 1e3 * value
    return demanded, merit


def rank(merits: Merits) -> NDArray[np.int64]:
    """Return the place (P,) of each particle, the best having 0.

    First come those that satisfy more of what is demanded: free of collisions, then meeting all
    constraints, then executable. Among equals the merit decides, the log-prior less penalties for
    what is missing of `SAFE_CLEARANCE` and of the constraints.
    """
    demanded, merit = demanded_and_merit(merits)
    order = np.lexsort((merit, demanded))[::-1]
    places = np.empty(len(order), np.int64)
    places[order] = np.arange(len(order))
    return places
