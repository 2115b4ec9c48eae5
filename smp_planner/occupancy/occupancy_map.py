"""The protocol of occupancy maps, and the occupancy of a signed distance.

Maps return a signed distance rather than with the occupancy probability of Eq. (12), because
one field of distance serves every sphere radius, edge width and margin: `occupancy` turns it into
the probability that a sphere of a given radius touches something.
"""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import expit

from smp_gym.compiling import kernel

__all__ = ["TRUNCATION", "OccupancyMap", "occupancy"]

TRUNCATION = 0.15
"""Truncation distance, m: maps return it beyond that distance from the surface."""


@runtime_checkable
class OccupancyMap(Protocol):
    """A scene as a field of signed distance, cut off at plus and minus `truncation`."""

    @property
    def truncation(self) -> float:
        """Largest absolute value of `signed_distance`, m; far from everything it is the value."""
        ...

    def signed_distance(self, points: ArrayLike) -> NDArray[np.float64]:
        """Return (...) m, negative inside, for points (..., 3) m in the base frame.

        Raises:
            ValueError: `points` has the wrong shape or is not finite.
        """
        ...

    def fill(
        self,
        values: NDArray[np.float32],
        origin: NDArray[np.float64],
        spacing: float,
        planes: tuple[int, int] | None = None,
    ) -> None:
        """Lower the nodes of a regular grid to the map's distance, where that is smaller.

        Args:
            values: (X, Y, Z) m, changed in place; node (i, j, k) is at origin + spacing (i, j, k).
            origin: (3,) m, base frame.
            spacing: m.
            planes: first of the planes of nodes along X that are lowered, and the one after the
                last; by default all of them. Several threads may lower some planes each.
        """
        ...


def occupancy(
    distance: ArrayLike, radius: ArrayLike = 0.0, edge_width: float = 0.01
) -> NDArray[Any]:
    """Return the probability that a sphere touches something: the sigmoid output of Eq. (12).

    Args:
        distance: (...) m, signed distance at the sphere's centre.
        radius: m, broadcast against `distance`.
        edge_width: m, scale of the sigmoid; the probability falls from 0.73 to 0.27 over twice it.

    Returns:
        (...) in [0, 1]: sigma(-(distance - radius) / edge_width).

    Raises:
        ValueError: `edge_width` is not positive.
    """
    if not edge_width > 0.0:
        raise ValueError(f"edge_width must be positive, got {edge_width}")
    return np.asarray(expit((np.asarray(radius) - np.asarray(distance)) / edge_width))


@kernel
def window(count, origin, spacing, center, reach):  # type: ignore[no-untyped-def]
    """Return (first, end) of the nodes of one grid axis within `reach` of `center`."""
    first = int(np.ceil((center - reach - origin) / spacing))
    end = int(np.floor((center + reach - origin) / spacing)) + 1
    return min(max(first, 0), count), min(max(end, 0), count)
