"""Protocol of the bodies that follow trajectories: collision cost, limits, exact check.

A body says what its trajectories cost on a map (Eq. (12)), which limits they must keep, and, by an
exact check, whether they are clear of obstacles. The pipeline knows nothing else of it.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.scene import Obstacle
from smp_planner.collision.clearances import Clearances
from smp_planner.collision.costs import Cost, ValueAndGradient
from smp_planner.occupancy.point_cloud import CloudMap
from smp_planner.planning.maps import SceneMaps
from smp_planner.planning.settings import PlanSettings

__all__ = ["Body", "Clearance", "ObstacleCost"]


class ObstacleCost(Protocol):
    """The collision cost of Eq. (12) on a map."""

    @property
    def scale(self) -> float:
        """Factor of the sum."""
        ...

    @property
    def clearances(self) -> Clearances:
        """The clearances whose occupancies are summed, one by one."""
        ...

    def __call__(
        self, trajectories: FloatArray, edge_width: float, margin: float
    ) -> ValueAndGradient:
        """Return value (P,) and gradient (P, T, D) at trajectories (P, T, D)."""
        ...


class Clearance(NamedTuple):
    """Results of the exact check of P whole trajectories.

    Attributes:
        clearance: (P,) least distance to an obstacle, negative inside; infinity without any.
        free: (P,) whether the whole trajectory touches nothing, the body itself included.
    """

    clearance: FloatArray
    free: BoolArray


class Body(Protocol):
    """Protocol of bodies; lengths are m, or extents for a ball."""

    @property
    def dimension(self) -> int:
        """D, number of coordinates of a configuration."""
        ...

    def obstacle_cost(
        self,
        obstacles: tuple[Obstacle, ...],
        cloud: CloudMap | None,
        maps: SceneMaps,
    ) -> ObstacleCost | None:
        """Return the collision cost on a map; None if there is nothing to meet.

        Args:
            obstacles: bodies at rest.
            cloud: map of a point cloud, if there is one.
            maps: of the problem.
        """
        ...

    def limit_costs(self, settings: PlanSettings) -> dict[str, tuple[float, Cost]]:
        """Return the costs of the body's own limits by name, each with its weight."""
        ...

    def check(
        self,
        trajectories: FloatArray,
        obstacles: tuple[Obstacle, ...],
        cloud: CloudMap | None = None,
    ) -> Clearance:
        """Check whole trajectories (P, T, D), between their samples, too."""
        ...

    def free_waypoints(
        self,
        trajectories: FloatArray,
        obstacles: tuple[Obstacle, ...],
        cloud: CloudMap | None = None,
    ) -> BoolArray:
        """Return (P, T) whether the configurations of trajectories (P, T, D) touch nothing."""
        ...

    def execution(self, trajectories: FloatArray, limit: float) -> tuple[BoolArray, FloatArray]:
        """Return whether trajectories can be executed within a duration, and their duration.

        Args:
            trajectories: (P, T, D).
            limit: s.

        Returns:
            (P,) whether limits hold, and (P,) s, shortest execution; NaN where nothing limits it.
        """
        ...

    def paths(self, trajectories: FloatArray, point: FloatArray | None) -> FloatArray:
        """Return the paths (P, T, 2 or 3) of the body, or of a point (3,) fixed to its hand."""
        ...
