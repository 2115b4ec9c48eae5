from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from scipy.optimize import minimize
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from smp_gym.geometry.distance import (
    PackedObstacles,
    local_distance,
    point_distance,
    point_distance_and_gradient,
    signed_distance,
    signed_distance_and_gradient,
)
from smp_gym.scene import TABLE, Obstacle
from smp_planner.occupancy.analytic import AnalyticMap
from smp_planner.occupancy.occupancy_map import OccupancyMap, occupancy

SIZES = {
    "box": (0.03, 0.06, 0.02),
    "cylinder": (0.03, 0.03, 0.06),
    "sphere": (0.05, 0.05, 0.05),
}


def body(shape: Any, seed: int = 0) -> Obstacle:
    rng = np.random.default_rng(seed)
    quaternion = rng.normal(size=4)
    quaternion /= np.linalg.norm(quaternion)
    x, y, z = rng.uniform(-0.1, 0.1, 3).tolist()
    a, b, c, d = quaternion.tolist()
    return Obstacle(shape=shape, position=(x, y, z), quaternion=(a, b, c, d), size=SIZES[shape])


def frame(obstacle: Obstacle) -> np.ndarray:
    transform = np.eye(4)
    transform[:3, :3] = Rotation.from_quat(obstacle.quaternion).as_matrix()
    transform[:3, 3] = obstacle.position
    return transform


def surface_samples(obstacle: Obstacle, spacing: float) -> np.ndarray:
    """Points of the body's surface, such that none of it is further than `spacing` from one."""
    if obstacle.shape == "cylinder":
        radius, _, half = obstacle.size
        angles = np.linspace(0.0, 2 * np.pi, round(2 * np.pi * radius / spacing))
        theta, z = np.meshgrid(angles, np.linspace(-half, half, round(2 * half / spacing)))
        side = np.stack([radius * np.cos(theta), radius * np.sin(theta), z], axis=-1)
        theta, rho = np.meshgrid(angles, np.linspace(0.0, radius, round(radius / spacing) + 1))
        cap = np.stack([rho * np.cos(theta), rho * np.sin(theta), np.full_like(rho, half)], axis=-1)
        parts = (side, cap, cap * [1, 1, -1])
        points = np.concatenate([part.reshape(-1, 3) for part in parts])
    else:
        if obstacle.shape == "sphere":
            mesh = trimesh.creation.icosphere(subdivisions=6, radius=obstacle.size[0])
        else:
            mesh = trimesh.creation.box(2 * np.array(obstacle.size))
        points, _ = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, 1.7 * spacing)
    return trimesh.transform_points(points, frame(obstacle))


@pytest.mark.parametrize("shape", SIZES)
def test_distance_is_the_distance_to_points_of_the_surface(shape: str) -> None:
    obstacle = body(shape)
    spacing = 0.001
    surface = surface_samples(obstacle, spacing)
    points = np.random.default_rng(1).uniform(-0.25, 0.25, (300, 3))
    nearest, _ = cKDTree(surface).query(points)

    distance = signed_distance(points, [obstacle])

    # The nearest sample may lie `spacing` beside the foot of the perpendicular.
    tolerance = 1e-5 + spacing**2 / np.maximum(2 * np.abs(distance), spacing)
    assert (np.abs(np.abs(distance) - nearest) < tolerance).all()


@pytest.mark.parametrize("shape", SIZES)
def test_sign_is_that_of_an_independent_inside_test(shape: str) -> None:
    obstacle = body(shape)
    points = np.random.default_rng(2).uniform(-0.15, 0.15, (20_000, 3))
    local = trimesh.transform_points(points, np.linalg.inv(frame(obstacle)))
    scaled = local / obstacle.size
    inside = {
        "box": (np.abs(scaled) < 1).all(axis=1),
        "cylinder": (np.hypot(scaled[:, 0], scaled[:, 1]) < 1) & (np.abs(scaled[:, 2]) < 1),
        "sphere": np.linalg.norm(scaled, axis=1) < 1,
    }[shape]
    assert inside.sum() > 100
    assert_allclose(signed_distance(points, [obstacle]) < 0, inside)


def test_outside_a_union_it_is_the_distance_to_the_nearest_point_of_any_body() -> None:
    obstacles = [body("box", 1), body("box", 2)]
    point = np.array([0.22, -0.18, 0.2])

    def distance_to(obstacle: Obstacle) -> float:
        rotation = Rotation.from_quat(obstacle.quaternion)

        def squared(u: np.ndarray) -> float:
            return float(np.sum((rotation.apply(u) + obstacle.position - point) ** 2))

        bounds = [(-h, h) for h in obstacle.size]
        result = minimize(squared, np.zeros(3), bounds=bounds, options={"ftol": 1e-16})
        return float(np.sqrt(result.fun))

    expected = min(distance_to(o) for o in obstacles)
    assert_allclose(signed_distance(point, obstacles), expected, atol=1e-6)


@pytest.mark.parametrize("shapes", [["box"], ["cylinder"], ["sphere"], list(SIZES)])
def test_gradient_agrees_with_finite_differences(shapes: list[str]) -> None:
    obstacles = [body(shape, seed) for seed, shape in enumerate(shapes)]
    points = np.random.default_rng(3).uniform(-0.2, 0.2, (500, 3))
    h = 1e-6
    steps = h * np.eye(3)
    plus = signed_distance(points[:, None] + steps, obstacles)
    minus = signed_distance(points[:, None] - steps, obstacles)

    distance, gradient = signed_distance_and_gradient(points, obstacles)

    assert_allclose(distance, signed_distance(points, obstacles))
    assert_allclose(gradient, (plus - minus) / (2 * h), atol=1e-6)
    assert_allclose(np.linalg.norm(gradient, axis=1), 1.0)


def test_gradient_at_centres_and_axes_is_a_unit_vector() -> None:
    obstacles = [body(shape, seed) for seed, shape in enumerate(SIZES)]
    for obstacle in obstacles:
        _, gradient = signed_distance_and_gradient(obstacle.position, [obstacle])
        assert_allclose(np.linalg.norm(gradient), 1.0)


def test_kernels_agree_with_the_checked_functions() -> None:
    obstacles = [body(shape, seed) for seed, shape in enumerate(SIZES)]
    packed = PackedObstacles.of(obstacles)
    x, y, z = point = (0.11, -0.07, 0.02)
    distance, gradient = signed_distance_and_gradient(point, obstacles)
    assert point_distance(x, y, z, *packed.arrays) == distance
    assert_allclose(point_distance_and_gradient(x, y, z, *packed.arrays), [distance, *gradient])


def test_skipping_by_bounding_balls_changes_nothing() -> None:
    rng = np.random.default_rng(4)
    obstacles = [body(shape, seed) for seed in range(8) for shape in SIZES] + [TABLE]
    points = rng.uniform(-0.4, 0.4, (5000, 3))
    alone = np.min([signed_distance(points, [o]) for o in obstacles], axis=0)
    assert_allclose(signed_distance(points, obstacles), alone, atol=1e-15)


@pytest.mark.parametrize("shape", SIZES)
def test_bounding_boxes_and_balls_hold_their_bodies(shape: str) -> None:
    obstacle = body(shape)
    packed = PackedObstacles.of([obstacle])
    offsets = surface_samples(obstacle, 0.005) - obstacle.position
    assert (np.abs(offsets) <= packed.half_extents[0] + 1e-9).all()
    assert np.linalg.norm(offsets, axis=1).max() == pytest.approx(packed.bound[0], rel=1e-3)


def test_local_distance_takes_one_size_per_point() -> None:
    sizes = np.array([[0.1, 0.1, 0.2], [0.3, 0.3, 0.1]])
    points = np.array([[0.0, 0.15, 0.0], [0.0, 0.0, -0.14]])
    assert_allclose(local_distance(points, "cylinder", sizes), [0.05, 0.04])


def test_shapes_of_the_result_follow_the_points() -> None:
    assert signed_distance(np.zeros((2, 5, 3)), [TABLE]).shape == (2, 5)
    assert signed_distance(np.zeros((0, 3)), [TABLE]).shape == (0,)
    assert signed_distance([0.0, 0.0, 0.3], [TABLE]) == pytest.approx(0.3)


def test_without_obstacles_everything_is_infinitely_far_and_the_map_is_at_its_truncation() -> None:
    points = np.zeros((4, 3))
    distance, gradient = signed_distance_and_gradient(points, ())
    assert np.isposinf(distance).all()
    assert (gradient == 0).all()
    assert (AnalyticMap((), truncation=0.1).signed_distance(points) == 0.1).all()


def test_map_is_truncated_on_both_sides() -> None:
    exact_map = AnalyticMap((TABLE,), truncation=0.03)
    assert isinstance(exact_map, OccupancyMap)
    heights = np.array([0.5, 0.02, -0.01, -0.05])
    points = heights[:, None] * [0.0, 0.0, 1.0]
    assert_allclose(exact_map.signed_distance(points), [0.03, 0.02, -0.01, -0.03])


def test_occupancy_is_a_half_where_the_sphere_touches() -> None:
    assert occupancy(0.04, radius=0.04, edge_width=0.01) == pytest.approx(0.5)
    assert_allclose(
        occupancy([0.03, 0.01], 0.02, 0.01), [1 / (1 + np.e), np.e / (1 + np.e)], rtol=1e-12
    )
    assert (occupancy([-1e3, 1e3], 0.0, 1e-3) == [1.0, 0.0]).all()


@pytest.mark.parametrize("points", [np.zeros(2), np.zeros((4, 2)), 0.0])
def test_points_of_wrong_shape_are_refused(points: Any) -> None:
    with pytest.raises(ValueError, match=r"points must have shape \(\.\.\., 3\)"):
        signed_distance(points, [TABLE])


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_points_that_are_not_finite_are_refused(bad: float) -> None:
    with pytest.raises(ValueError, match=f"points must be finite.*{bad}"):
        signed_distance([[0.0, 0.0, 0.0], [0.0, bad, 0.0]], [TABLE])


@pytest.mark.parametrize("width", [0.0, -1.0, np.nan])
def test_edge_width_must_be_positive(width: float) -> None:
    with pytest.raises(ValueError, match="edge_width must be positive"):
        occupancy(0.1, 0.0, width)


@pytest.mark.parametrize("truncation", [0.0, -0.1, np.inf, np.nan])
def test_truncation_must_be_positive(truncation: float) -> None:
    with pytest.raises(ValueError, match=r"AnalyticMap\.truncation must be positive"):
        AnalyticMap((TABLE,), truncation)
