"""What moves along a path: what a scene needs to know of it, whatever it is."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from smp_planner.collision.costs import REFERENCE_STEPS

__all__ = ["Check", "Mover", "ValueAndGradient", "steps_scale"]

FloatArray = NDArray[np.float64]
ValueAndGradient = tuple[FloatArray, FloatArray]


def steps_scale(steps: int) -> float:
    """Return the factor that a sum over steps has, so that weights do not depend on their number.

    The step from one to the next counts, not the steps: then a path among obstacles that its ends
    are clear of costs the same however finely it is sampled. It is 1 for `costs.REFERENCE_STEPS`.
    """
    return (REFERENCE_STEPS - 1) / (steps - 1)


class Check(NamedTuple):
    """What a check of whole paths found, for P of them.

    Attributes:
        clearance: (P,) least distance to an obstacle, in the scene's unit; infinity without any.
        free: (P,) whether nothing is touched.
        executable: (P,) whether limits of joints and velocities hold.
        duration: (P,) s, shortest execution; NaN where nothing limits it.
    """

    clearance: FloatArray
    free: NDArray[np.bool_]
    executable: NDArray[np.bool_]
    duration: FloatArray


class Mover(Protocol):
    """A body among obstacles, given by its path."""

    def collision(
        self, trajectories: FloatArray, edge_width: float, margin: float
    ) -> ValueAndGradient:
        """Return the collision cost (P,) of Eq. (12) of paths (P, T, D), and its gradient.

        Sums are scaled by `steps_scale`.
        """
        ...

    def limits(self, trajectories: FloatArray) -> dict[str, tuple[float, ValueAndGradient]]:
        """Return further costs by name: weight, value (P,), gradient (P, T, D)."""
        ...

    def check(self, trajectories: FloatArray) -> Check:
        """Check whole paths (P, T, D), between their samples, too.

        It asks bodies themselves, and of a `PointCloud` the map that was learned of it.
        """
        ...
