from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.interpolate import RegularGridInterpolator

from smp_gym.geometry.distance import signed_distance
from smp_gym.scene import TABLE, Goal, Obstacle, Scene, fixtures
from smp_planner.occupancy.analytic import AnalyticMap
from smp_planner.occupancy.grid import (
    BLOCK,
    SPACING,
    WORKSPACE,
    DistanceGrid,
    bake,
    bake_analytic,
    grid_nodes,
    lookup,
)
from smp_planner.occupancy.occupancy_map import TRUNCATION
from smp_planner.occupancy.redistancing import redistance
from smp_planner.occupancy.shape_networks import ShapeNetworkMap, default_networks

SCENE = Scene(
    task="Placement",
    start=(0.0,) * 6,
    goals=(Goal(position=(0.45, 0.3, 0.01)),),
    obstacles=(
        Obstacle(shape="box", position=(0.4, -0.2, 0.05), size=(0.04, 0.06, 0.05)),
        Obstacle(
            shape="cylinder",
            position=(0.6, 0.05, 0.3),
            quaternion=(0.5, 0.5, 0.5, 0.5),
            size=(0.04, 0.04, 0.06),
        ),
        Obstacle(shape="sphere", position=(0.3, 0.1, 0.5), size=(0.05, 0.05, 0.05)),
        Obstacle(
            shape="box",
            position=(0.2, -0.5, 0.3),
            quaternion=(0.1, 0.3, 0.9, 0.3),
            size=(0.05, 0.03, 0.04),
        ),
    ),
)
BODIES = (*SCENE.obstacles, *fixtures(SCENE))


def random_grid(seed: int = 0) -> DistanceGrid:
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(5, 6, 7)).astype(np.float32)
    return DistanceGrid(np.array([0.1, -0.3, 0.2]), 0.05, values)


def random_points(grid: DistanceGrid, count: int) -> np.ndarray:
    upper = grid.origin + grid.spacing * (np.array(grid.values.shape) - 1)
    return np.random.default_rng(1).uniform(grid.origin, upper, (count, 3))


def test_lookup_agrees_with_another_interpolator() -> None:
    grid = random_grid()
    axes = [grid.origin[i] + grid.spacing * np.arange(grid.values.shape[i]) for i in range(3)]
    interpolate = RegularGridInterpolator(axes, grid.values.astype(np.float64))
    points = random_points(grid, 1000)
    assert_allclose(grid.query(points), interpolate(points), atol=1e-12)


def test_lookup_gives_nodes_back_including_the_last() -> None:
    grid = random_grid()
    for index in itertools.product((0, 2, 4), (0, 3, 5), (0, 1, 6)):
        point = grid.origin + grid.spacing * np.array(index)
        assert grid.query(point) == pytest.approx(grid.values[index], abs=1e-6)


def test_gradient_agrees_with_finite_differences() -> None:
    grid = random_grid()
    points = random_points(grid, 1000)
    h = 1e-7
    cell = (points - grid.origin) / grid.spacing % 1.0
    points = points[((cell > 1e-4) & (cell < 1 - 1e-4)).all(axis=1)]
    steps = h * np.eye(3)
    plus, minus = grid.query(points[:, None] + steps), grid.query(points[:, None] - steps)
    distance, gradient = grid.query_with_gradient(points)
    assert_allclose(distance, grid.query(points))
    assert_allclose(gradient, (plus - minus) / (2 * h), atol=1e-5)


def test_outside_the_boundary_answers_and_slopes_only_along_it() -> None:
    grid = random_grid()
    inside = np.array([0.22, -0.14, 0.31])
    beyond, border = inside.copy(), inside.copy()
    beyond[0], border[0] = 7.0, grid.origin[0] + 4 * grid.spacing
    distance, gradient = grid.query_with_gradient(beyond)
    expected, slope = grid.query_with_gradient(border)
    assert distance == pytest.approx(expected)
    assert gradient[0] == 0.0
    assert_allclose(gradient[1:], slope[1:], atol=1e-9)
    corner = grid.query_with_gradient([-9.0, -9.0, -9.0])
    assert corner[0] == pytest.approx(grid.values[0, 0, 0])
    assert (corner[1] == 0.0).all()


def test_kernel_agrees_with_the_checked_query() -> None:
    grid = random_grid()
    point = (0.17, -0.2, 0.33)
    distance, gradient = grid.query_with_gradient(point)
    found = lookup(grid.values, grid.origin, 1 / grid.spacing, *point)
    assert_allclose(found, [distance, *gradient])


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
def test_kernel_reads_only_the_grid_whatever_it_is_asked(bad: float) -> None:
    grid = random_grid()
    distance, *gradient = lookup(grid.values, grid.origin, 1 / grid.spacing, 0.17, bad, 0.33)
    assert grid.values.min() <= distance <= grid.values.max()
    assert np.isfinite(gradient).all()


@pytest.mark.parametrize("spacing", [0.03, 0.047])
def test_baked_nodes_hold_the_exact_truncated_distance(spacing: float) -> None:
    grid = bake_analytic(BODIES, spacing=spacing)
    origin, nodes = grid_nodes(WORKSPACE, spacing)
    assert grid.values.shape == nodes
    points = origin + spacing * np.stack(np.indices(nodes), axis=-1)
    expected = np.clip(signed_distance(points, BODIES), -TRUNCATION, TRUNCATION)
    assert_allclose(grid.values, expected, atol=1e-7)
    assert (points.max(axis=(0, 1, 2)) >= np.array(WORKSPACE[1]) - 1e-9).all()


@pytest.mark.parametrize("spacing", [0.03, 0.047])
def test_baked_networks_agree_with_the_networks_at_the_nodes(spacing: float) -> None:
    network_map = ShapeNetworkMap(BODIES, default_networks())
    grid = bake(network_map, spacing=spacing)
    points = grid.origin + spacing * np.stack(np.indices(grid.values.shape), axis=-1)
    assert_allclose(grid.values, network_map.signed_distance(points), atol=1e-6)


def test_a_rotated_table_is_baked_like_any_other_body() -> None:
    table = TABLE.model_copy(update={"quaternion": (0.0, 0.1, 0.0, np.sqrt(0.99))})
    network_map = ShapeNetworkMap((table,), default_networks())
    grid = bake(network_map, spacing=0.05)
    points = grid.origin + 0.05 * np.stack(np.indices(grid.values.shape), axis=-1)
    exact = AnalyticMap((table,)).signed_distance(points)
    # Where the distance is cut off, deep inside, the networks round the corner.
    sharp = exact > -0.9 * TRUNCATION
    assert_allclose(grid.values[sharp], exact[sharp], atol=3e-3)


def test_default_grid_is_within_half_a_spacing_of_the_exact_distance() -> None:
    grid = bake(ShapeNetworkMap(BODIES, default_networks()))
    points = np.random.default_rng(2).uniform(*WORKSPACE, (200_000, 3))
    exact = signed_distance(points, BODIES)
    near = (np.abs(exact) < 0.03) & (signed_distance(points, [TABLE]) > 0.04)
    error = np.abs(grid.query(points) - exact)[near]
    assert near.sum() > 500
    assert np.percentile(error, 95) < 0.3 * SPACING
    # On a crease of the distance between two nodes, an interpolant is off by half of sqrt(3) h.
    assert error.max() < 0.9 * SPACING


def test_without_obstacles_a_grid_is_at_its_truncation() -> None:
    for empty in (AnalyticMap(()), ShapeNetworkMap((), default_networks())):
        grid = bake(empty, spacing=0.1)
        assert (grid.values == np.float32(empty.truncation)).all()


def test_obstacles_outside_the_workspace_are_left_out() -> None:
    far = Obstacle(shape="sphere", position=(3.0, 0.0, 0.5), size=(0.1, 0.1, 0.1))
    assert (bake_analytic((far,), spacing=0.1).values == np.float32(TRUNCATION)).all()
    network_grid = bake(ShapeNetworkMap((far,), default_networks()), spacing=0.1)
    assert (network_grid.values == np.float32(TRUNCATION)).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_points_that_are_not_finite_are_refused(bad: float) -> None:
    with pytest.raises(ValueError, match="points must be finite"):
        random_grid().query([[0.1, bad, 0.2]])


@pytest.mark.parametrize(
    ("workspace", "spacing", "message"),
    [
        (((0, 0, 0), (1, 1, 0)), 0.1, "lower corner first"),
        (((0, 0), (1, 1)), 0.1, "two corners of 3 finite numbers"),
        (((0, 0, np.nan), (1, 1, 1)), 0.1, "two corners of 3 finite numbers"),
        (WORKSPACE, 0.0, "spacing must be positive"),
        (WORKSPACE, np.nan, "spacing must be positive"),
    ],
)
def test_impossible_grids_are_refused(workspace: Any, spacing: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        bake_analytic(BODIES, workspace, spacing)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"origin": np.zeros(2)}, "origin must be 3 finite numbers"),
        ({"spacing": -0.1}, "spacing must be positive"),
        ({"values": np.zeros((3, 3))}, "3 axes of at least 2 nodes"),
        ({"values": np.zeros((3, 1, 3))}, "3 axes of at least 2 nodes"),
    ],
)
def test_impossible_grid_data_are_refused(change: dict[str, Any], message: str) -> None:
    fields = {"origin": np.zeros(3), "spacing": 0.1, "values": np.zeros((3, 3, 3))}
    with pytest.raises(ValueError, match=message):
        DistanceGrid(**{**fields, **change})


def test_redistancing_recovers_distance_from_any_function_of_the_same_sign() -> None:
    spacing, radius = 0.02, 0.11
    points = spacing * (np.stack(np.indices((31, 31, 31)), axis=-1) - 15) + 0.003
    exact = np.linalg.norm(points, axis=-1) - radius
    level = 40.0 * np.tanh(-30.0 * exact)
    found = redistance(level, spacing, 0.15)
    clipped = np.clip(exact, -0.15, 0.15)
    assert np.abs(found - clipped).max() < spacing
    assert np.abs(found - clipped).mean() < 0.15 * spacing
    near = np.abs(exact) < spacing
    assert np.abs(found - exact)[near].mean() < 0.1 * spacing
    assert ((found < 0) == (exact < 0)).all()


def test_redistancing_of_one_sign_is_the_truncation() -> None:
    assert (redistance(-np.ones((4, 4, 4)), 0.1, 0.2) == np.float32(0.2)).all()
    with pytest.raises(ValueError, match="finite array with 3 axes"):
        redistance(np.full((4, 4, 4), np.nan), 0.1, 0.2)


@pytest.mark.parametrize("shape", [(2, 2, 2), (5, 9, 6), (14, 8, 13)])
def test_blocks_hold_the_least_value_of_their_cells(shape):
    values = np.random.default_rng(5).normal(size=shape).astype(np.float32)
    blocks = DistanceGrid(np.zeros(3), 0.1, values).least_of_blocks
    assert blocks.shape == tuple(-(-(n - 1) // BLOCK) for n in shape)
    for index in np.ndindex(blocks.shape):
        nodes = tuple(slice(BLOCK * i, BLOCK * i + BLOCK + 1) for i in index)
        assert blocks[index] == values[nodes].min()
