"""The push of a box along the table, as a part of a way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smp_gym.robot import kinematics
from smp_gym.sampling.detours import smoothstep

__all__ = ["Push"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Push:
    """A push on the way, after which the hand holds the object.

    Attributes:
        phases: of its begin, the hand behind the object, and of its end, the hand closing.
        spheres: as `Body.spheres`, which hold until it ends, but with the fingers closed and the
            object between them. Before, the object's spheres rest within the palm.
        configurations: (K, 6) rad, at equal steps of its way.
        object_path: (K, 1, 3) m, where the object's centre is meanwhile.
        object_radius: (1,) m, of a sphere around the object.
        object_row: (1, 9) the object before the push, as a row for the kernels.
    """

    phases: tuple[float, float]
    spheres: kinematics.SphereSet
    configurations: FloatArray
    object_path: FloatArray
    object_radius: FloatArray
    object_row: FloatArray

    def at(self, phase: FloatArray) -> FloatArray:
        """Return the configurations (T, 6) rad at phases (T,); at rest outside of the push."""
        begin, end = self.phases
        share = smoothstep(np.clip((phase - begin) / (end - begin), 0.0, 1.0))
        knots = np.linspace(0.0, 1.0, len(self.configurations))
        # The polynomial through all knots (Lagrange): the joints' ways are smooth.
        weights = np.stack(
            [
                np.prod(
                    [(share - other) / (knot - other) for other in knots if other != knot], axis=0
                )
                for knot in knots
            ],
            axis=1,
        )
        return np.asarray(np.einsum("tk,kj->tj", weights, self.configurations))
