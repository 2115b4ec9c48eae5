"""Distance maps of a scene: its obstacles themselves, or the paper's networks, as grids."""

from __future__ import annotations

from typing import Any

import numpy as np

from smp_gym.geometry.distance import PackedObstacles
from smp_gym.scene import Obstacle
from smp_planner.occupancy.analytic import AnalyticMap
from smp_planner.occupancy.grid import WORKSPACE, DistanceGrid, bake, fill_slabs
from smp_planner.occupancy.neural import (
    INFLATION,
    PointNetworkMap,
    sample_labelled_points,
    train_map,
)
from smp_planner.occupancy.occupancy_map import TRUNCATION, OccupancyMap
from smp_planner.occupancy.shape_networks import ShapeNetworkMap, default_networks
from smp_planner.planning.settings import PlanSettings
from smp_planner.planning.threads import Threads

__all__ = ["WORKSPACE", "SceneMaps", "Workspace", "around_both", "lowered"]

Workspace = tuple[tuple[float, ...], tuple[float, ...]]
"""Lower and upper corner of a box, m (extents for paths in the plane or in space)."""


def around_both(first: Workspace, second: Workspace) -> Workspace:
    """Return the smallest box around two."""
    lower, upper = np.minimum(first[0], second[0]), np.maximum(first[1], second[1])
    return tuple(lower.tolist()), tuple(upper.tolist())


class SceneMaps:
    """Distance maps of one problem, each made once.

    Args:
        settings: kind of map, and how a network is trained.
        seed: of points and training.
        made: maps that there are already, to which those made here are added.
        threads: that share the making of a map; by default, the caller's alone.
    """

    def __init__(
        self,
        settings: PlanSettings,
        seed: int,
        made: dict[Any, Any] | None = None,
        threads: Threads | None = None,
    ) -> None:
        self._settings, self._seed = settings, seed
        self._over = (threads or Threads(1)).over
        self._made: dict[tuple[tuple[Obstacle, ...], Workspace, int], DistanceGrid | None]
        self._made = {} if made is None else made

    @property
    def exact(self) -> bool:
        """True if distances are those of the obstacles themselves, without a map."""
        return self._settings.map == "exact"

    def grid(self, obstacles: tuple[Obstacle, ...], workspace: Workspace) -> DistanceGrid | None:
        """Return the distance to obstacles over a workspace.

        Args:
            obstacles: in coordinates in which 1 is about the size of the scene: m, or extents.
            workspace: box that the grid covers.

        Returns:
            The map; None if a network is to be trained and no obstacle reaches into the workspace.
        """
        key = obstacles, workspace, self._seed if self._settings.map == "points" else 0
        if key not in self._made:
            self._made[key] = self._make(obstacles, workspace)
        return self._made[key]

    def _make(self, obstacles: tuple[Obstacle, ...], workspace: Workspace) -> DistanceGrid | None:
        settings = self._settings
        if settings.map != "points":
            return self._composed(obstacles, workspace)
        packed = PackedObstacles.of(obstacles)
        lower, upper = np.asarray(workspace[0]), np.asarray(workspace[1])
        around = packed.half_extents + INFLATION
        inside = (packed.position - around < upper) & (packed.position + around > lower)
        if not inside.all(axis=1).any():
            return None
        rng = np.random.default_rng([self._seed, 2])
        points, labels = sample_labelled_points(
            obstacles, settings.map_points, rng, workspace=workspace
        )
        network = train_map(
            points,
            labels,
            inflation=INFLATION,
            steps=settings.map_steps,
            seed=self._seed % 2**63,
        )
        return PointNetworkMap.of(network, workspace).grid

    def _composed(self, obstacles: tuple[Obstacle, ...], workspace: Workspace) -> DistanceGrid:
        """Return the minimum over obstacles, begun with a map of the most of them there is."""
        known: tuple[Obstacle, ...] = ()
        for made, around, _ in self._made:
            if around == workspace and len(made) > len(known) and set(made) <= set(obstacles):
                known = made
        rest = tuple(obstacle for obstacle in obstacles if obstacle not in known)
        composed: OccupancyMap = AnalyticMap(rest, TRUNCATION)
        if self._settings.map == "shapes":
            composed = ShapeNetworkMap(rest, default_networks())
        begun = self._made.get((known, workspace, 0)) if known else None
        if begun is None:
            return bake(composed, workspace, over=self._over)
        values = begun.values.copy()
        fill_slabs(composed, values, begun.origin, begun.spacing, self._over)
        return DistanceGrid(begun.origin, begun.spacing, values)


def lowered(grid: DistanceGrid, other: OccupancyMap) -> DistanceGrid:
    """Return the minimum of a grid and of another map, as far as that reaches."""
    values = grid.values.copy()
    other.fill(values, grid.origin, grid.spacing)
    return DistanceGrid(grid.origin, grid.spacing, values)
