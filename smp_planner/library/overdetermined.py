"""Requests that leave a path no freedom, or force it far out."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from smp_gym.arrays import FloatArray
from smp_planner.movement_primitives import ProMP
from smp_planner.planning.constraints import Constraint, Passing

__all__ = ["MOST_SWING", "refuse_overdetermined"]

MOST_SWING = 1.0
"""How far beyond the box around demonstrations and requests the path that meets all requests may
be forced, in lengths of its longest side."""

_SAMPLES = 200


def refuse_overdetermined(
    primitive: ProMP, constraints: Sequence[Constraint], demonstrations: Sequence[FloatArray]
) -> None:
    """Raise a ValueError if no freedom is left to a primitive, or it must swing out wildly.

    Args:
        primitive: of the path.
        constraints: on it; counted are places that are the only one of a phase.
        demonstrations: N arrays (T_j, D), normalised.
    """
    held = [c for c in constraints if isinstance(c, Passing) and len(c.places) == 1]
    held = [c for c in held if c.places[0].point is not None]
    exact = {c.phase for c in held if c.places[0].tolerance == 0.0}
    count = primitive.basis.count
    if len(exact) >= count:
        raise ValueError(
            f"via_points, start and goal hold the path exactly at {len(exact)} phases, but its "
            f"{count} basis functions allow {count - 1}: give via-points a tolerance, leave some "
            f"out, or learn with SMP.fit(..., basis_functions={len(exact) + 5})"
        )
    if len(held) < 2:
        return
    points = np.array([c.places[0].point for c in held])
    around = np.concatenate([*demonstrations, points])
    lower, upper = np.nanmin(around, axis=0), np.nanmax(around, axis=0)
    swing = np.inf
    try:
        for constraint in held:
            primitive, _ = constraint.places[0].condition(primitive, constraint.phase)
        path = primitive.trajectory(primitive.mean, _SAMPLES).numpy()
        swing = float(np.maximum(lower - path, path - upper).max() / (upper - lower).max())
    except ValueError:
        # What is not met at all counts as infinitely far.
        pass
    if not swing <= MOST_SWING:
        held.sort(key=lambda c: c.phase)
        first, second = min(pairwise(held), key=lambda pair: pair[1].phase - pair[0].phase)
        raise ValueError(
            f"{first.name} and {second.name}, {second.phase - first.phase:.3g} of the phase apart, "
            f"cannot both be met by a path of {count} basis functions without swinging "
            f"{swing:.3g} times the extent of all demonstrations and requests beyond these: set "
            "them further apart, give them a tolerance, or learn with more basis_functions"
        )
