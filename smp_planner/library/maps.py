"""The map of a scene: its obstacles themselves, or the paper's network, learned from points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from smp_gym.geometry.distance import PackedObstacles
from smp_gym.scene import Obstacle
from smp_planner.occupancy.grid import DistanceGrid, bake_analytic
from smp_planner.occupancy.neural import (
    INFLATION,
    PointNetworkMap,
    sample_labelled_points,
    train_map,
)
from smp_planner.occupancy.occupancy_map import OccupancyMap

__all__ = ["Workspace", "around_both", "exact_grid", "lowered", "neural_grid"]

Workspace = tuple[Sequence[float], Sequence[float]]


def around_both(first: Workspace, second: Workspace) -> Workspace:
    """Return the smallest box around two."""
    lower, upper = np.minimum(first[0], second[0]), np.maximum(first[1], second[1])
    return tuple(lower.tolist()), tuple(upper.tolist())


def exact_grid(obstacles: Sequence[Obstacle], workspace: Workspace) -> DistanceGrid:
    """Return the exact distance to obstacles over a workspace."""
    return bake_analytic(obstacles, workspace)


def neural_grid(
    obstacles: Sequence[Obstacle], workspace: Workspace, points: int, steps: int, seed: int
) -> DistanceGrid | None:
    """Return the distance to the surface that a network learned from labelled points, Eq. (12).

    Args:
        obstacles: in coordinates in which 1 is about the size of the scene: m, or extents.
        workspace: lower and upper corner of the box that is learned.
        points: how many to learn from.
        steps: of the training.
        seed: of points and training.

    Returns:
        The map; None if no obstacle reaches into the workspace.
    """
    packed = PackedObstacles.of(obstacles)
    lower, upper = np.asarray(workspace[0]), np.asarray(workspace[1])
    around = packed.half_extents + INFLATION
    inside = (packed.position - around < upper) & (packed.position + around > lower)
    if not inside.all(axis=1).any():
        return None
    rng = np.random.default_rng([seed, 2])
    drawn, labels = sample_labelled_points(obstacles, points, rng, workspace=workspace)
    network = train_map(drawn, labels, inflation=INFLATION, steps=steps, seed=seed)
    return PointNetworkMap.of(network, workspace).grid


def lowered(grid: DistanceGrid, other: OccupancyMap) -> DistanceGrid:
    """Return a grid that knows of what another map knows, too, as far as it reaches."""
    values = grid.values.copy()
    other.fill(values, grid.origin, grid.spacing)
    return DistanceGrid(grid.origin, grid.spacing, values)
