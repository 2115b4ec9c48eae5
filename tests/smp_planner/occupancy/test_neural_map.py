from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from smp_gym.geometry.distance import signed_distance
from smp_gym.scene import SHAPES, TABLE, Goal, Obstacle, Scene, fixtures
from smp_planner.occupancy.neural import (
    PointNetwork,
    PointNetworkMap,
    sample_labelled_points,
    train_map,
)
from smp_planner.occupancy.occupancy_map import OccupancyMap
from smp_planner.occupancy.shape_networks import (
    ShapeNetworkMap,
    ShapeNetworks,
    default_networks,
    face_offsets,
)
from smp_planner.occupancy.shape_training import sample_shape_distances, train_shape_networks

BALL = Obstacle(shape="sphere", position=(0.1, 0.0, 0.3), size=(0.1, 0.1, 0.1))
BOX = ((-0.3, -0.3, 0.0), (0.3, 0.3, 0.6))


def random_obstacle(shape: Any, rng: np.random.Generator, low: float, high: float) -> Obstacle:
    a, b, c = np.exp(rng.uniform(np.log(low), np.log(high), 3)).tolist()
    size = {"box": (a, b, c), "cylinder": (a, a, c), "sphere": (a, a, a)}[shape]
    x, y, z = rng.uniform([0.2, -0.5, 0.0], [0.7, 0.5, 0.6]).tolist()
    q0, q1, q2, q3 = Rotation.from_quat(rng.normal(size=4)).as_quat().tolist()
    return Obstacle(shape=shape, position=(x, y, z), quaternion=(q0, q1, q2, q3), size=size)


def random_scene(seed: int) -> tuple[Obstacle, ...]:
    rng = np.random.default_rng(seed)
    obstacles = tuple(random_obstacle(SHAPES[rng.integers(3)], rng, 0.03, 0.06) for _ in range(4))
    x, y = rng.uniform([0.3, -0.4], [0.6, 0.4]).tolist()
    goal = Goal(position=(x, y, 0.01))
    return (*obstacles, *fixtures(Scene(task="Placement", start=(0.0,) * 6, goals=(goal,))))


def points_around(obstacle: Obstacle, count: int, rng: np.random.Generator) -> np.ndarray:
    local = rng.uniform(-1, 1, (count, 3)) * (np.array(obstacle.size) + 0.1)
    rotation = Rotation.from_quat(obstacle.quaternion)
    return rotation.apply(local) + np.array(obstacle.position)


@pytest.fixture(scope="module")
def ball_network() -> PointNetwork:
    points, labels = sample_labelled_points(
        [BALL], 20_000, np.random.default_rng(0), inflation=0.02, workspace=BOX
    )
    return train_map(points, labels, inflation=0.02, hidden=(32, 32), steps=600)


class TestShapeNetworks:
    @pytest.mark.parametrize("shape", SHAPES)
    @pytest.mark.parametrize("bounds", [(0.005, 0.15), (0.03, 0.06)])
    def test_distance_is_exact_to_a_millimetre_near_the_surface(
        self, shape: str, bounds: tuple[float, float]
    ) -> None:
        rng = np.random.default_rng(1)
        errors = []
        for _ in range(50):
            obstacle = random_obstacle(shape, rng, *bounds)
            points = points_around(obstacle, 4000, rng)
            exact = signed_distance(points, [obstacle])
            found = ShapeNetworkMap((obstacle,), default_networks()).signed_distance(points)
            errors.append((found - exact)[np.abs(exact) < 0.03])
        assert np.percentile(np.abs(np.concatenate(errors)), 95) < 1e-3
        assert np.abs(np.concatenate(errors)).max() < 4e-3

    @pytest.mark.parametrize("size", [(0.005, 0.09, 0.05), (1.5, 1.5, 0.05), (0.08, 0.005, 0.05)])
    def test_walls_and_tables_are_no_exception(self, size: tuple[float, float, float]) -> None:
        obstacle = Obstacle(shape="box", position=(0.0, 0.0, 0.0), size=size)
        points = points_around(obstacle, 20_000, np.random.default_rng(2))
        exact = np.clip(signed_distance(points, [obstacle]), -0.15, 0.15)
        found = ShapeNetworkMap((obstacle,), default_networks()).signed_distance(points)
        assert np.abs(found - exact).max() < 4e-3

    def test_occupancy_is_right_inside_and_outside_of_whole_scenes(self) -> None:
        for seed in range(5):
            scene = random_scene(seed)
            rng = np.random.default_rng(seed)
            points = np.concatenate([points_around(o, 5000, rng) for o in scene[:4]])
            exact = signed_distance(points, scene)
            occupied = ShapeNetworkMap(scene, default_networks()).signed_distance(points) < 0
            assert np.mean(occupied[exact <= -0.01]) >= 0.99
            assert np.mean(occupied[(exact >= 0.02) & (exact <= 0.06)]) <= 0.02

    def test_far_away_and_without_obstacles_it_is_the_truncation(self) -> None:
        networks = default_networks()
        far = ShapeNetworkMap((BALL,), networks).signed_distance([0.1, 0.0, 0.3 + 0.1 + 0.16])
        assert far == networks.truncation
        empty = ShapeNetworkMap((), networks)
        assert (empty.signed_distance(np.zeros((3, 3))) == networks.truncation).all()
        assert isinstance(empty, OccupancyMap)

    def test_evaluation_agrees_with_torch(self) -> None:
        networks = default_networks()
        points = points_around(BALL, 1000, np.random.default_rng(3))
        inputs = face_offsets(
            points - np.array(BALL.position),
            "sphere",
            np.tile(BALL.size, (1000, 1)),
            networks.truncation,
        )
        sphere = SHAPES.index("sphere")
        w1, b1, w2, b2, w3, b3 = (torch.as_tensor(a[sphere]).double() for a in networks.arrays)
        hidden = torch.tanh(torch.from_numpy(inputs) @ w1.T + b1)
        output = torch.tanh(hidden @ w2.T + b2) @ w3 + b3
        expected = np.clip(networks.truncation * output.numpy(), -0.15, 0.15)
        inside = inputs[:, 0] < 1.0
        found = ShapeNetworkMap((BALL,), networks).signed_distance(points)
        assert_allclose(found[inside], expected[inside], atol=1e-6)

    def test_offsets_are_sorted_and_cut_off(self) -> None:
        offsets = face_offsets(
            np.array([[0.5, -0.02, 0.0], [0.0, 0.0, 0.3]]),
            "box",
            np.array([[0.4, 0.04, 1.0], [0.1, 0.1, 0.1]]),
            0.1,
        )
        assert_allclose(offsets, [[1.0, -0.2, -1.0], [2.0, -1.0, -1.0]], atol=1e-12)

    def test_training_learns(self) -> None:
        networks = train_shape_networks(hidden=6, rounds=1, iterations=100, samples=500, seed=1)
        points = points_around(BALL, 2000, np.random.default_rng(4))
        exact = signed_distance(points, [BALL])
        found = ShapeNetworkMap((BALL,), networks).signed_distance(points)
        assert np.abs(found - exact)[np.abs(exact) < 0.05].mean() < 3e-3

    def test_training_is_repeatable(self) -> None:
        first, second = (
            train_shape_networks(hidden=4, rounds=1, iterations=5, samples=50, seed=2)
            for _ in range(2)
        )
        for a, b in zip(first.arrays, second.arrays, strict=True):
            assert (a == b).all()

    def test_training_refuses_what_it_cannot_do(self) -> None:
        with pytest.raises(ValueError, match="hidden must be at least 1, got 0"):
            train_shape_networks(hidden=0)
        with pytest.raises(ValueError, match=r"shape must be one of.*'cone'"):
            sample_shape_distances("cone", 10, np.random.default_rng(0))

    @pytest.mark.parametrize("bad", [np.nan, np.inf])
    def test_points_that_are_not_finite_are_refused(self, bad: float) -> None:
        with pytest.raises(ValueError, match="points must be finite"):
            ShapeNetworkMap((BALL,), default_networks()).signed_distance([0.0, bad, 0.0])

    def test_arrays_of_wrong_shape_or_value_are_refused(self) -> None:
        networks = default_networks()
        with pytest.raises(ValueError, match=r"ShapeNetworks\.weight2 must be \(3, "):
            dataclasses.replace(networks, weight2=networks.weight2[:2])
        with pytest.raises(ValueError, match=r"ShapeNetworks\.bias1 must be finite"):
            dataclasses.replace(networks, bias1=np.full_like(networks.bias1, np.nan))
        with pytest.raises(ValueError, match=r"ShapeNetworks\.truncation must be positive"):
            dataclasses.replace(networks, truncation=0.0)


class TestPointNetwork:
    def test_it_learns_where_the_scene_is_occupied(self, ball_network: PointNetwork) -> None:
        learned = PointNetworkMap.of(ball_network, workspace=BOX)
        points = np.random.default_rng(5).uniform(*BOX, (20_000, 3))
        exact = signed_distance(points, [BALL])
        found = learned.signed_distance(points)
        assert isinstance(learned, OccupancyMap)
        assert np.mean(found[exact <= -0.01] < 0) >= 0.99
        assert np.mean(found[(exact >= 0.02) & (exact <= 0.06)] < 0) <= 0.02
        near = np.abs(exact) < 0.05
        assert np.percentile(np.abs(found - exact)[near], 95) < 0.01

    def test_probability_is_high_inside_and_low_outside(self, ball_network: PointNetwork) -> None:
        inside, outside = ball_network.probability([BALL.position, (-0.2, -0.2, 0.5)])
        assert inside > 0.99
        assert outside < 0.01

    def test_baking_repeats_the_map_at_the_nodes(self, ball_network: PointNetwork) -> None:
        learned = PointNetworkMap.of(ball_network, workspace=BOX, spacing=0.03)
        values = np.full((5, 5, 5), learned.truncation, np.float32)
        origin = np.array([-0.05, -0.1, 0.2])
        learned.fill(values, origin, 0.05)
        nodes = origin + 0.05 * np.stack(np.indices(values.shape), axis=-1)
        assert_allclose(values, learned.signed_distance(nodes), atol=1e-6)
        assert values.min() < 0

    def test_thin_walls_are_found_after_inflation(self) -> None:
        wall = Obstacle(shape="box", position=(0.0, 0.0, 0.3), size=(0.005, 0.1, 0.1))
        points, labels = sample_labelled_points(
            [wall], 20_000, np.random.default_rng(6), inflation=0.02, workspace=BOX
        )
        network = train_map(points, labels, inflation=0.02, hidden=(32, 32), steps=600)
        learned = PointNetworkMap.of(network, workspace=BOX)
        y, z = np.meshgrid(np.linspace(-0.08, 0.08, 9), np.linspace(0.22, 0.38, 9))
        middle = np.stack([np.zeros_like(y), y, z], axis=-1)
        assert_allclose(learned.signed_distance(middle), -0.005, atol=0.012)
        assert_allclose(
            learned.signed_distance(middle + np.array([0.045, 0.0, 0.0])), 0.04, atol=0.01
        )

    def test_training_is_repeatable(self) -> None:
        points, labels = sample_labelled_points([BALL], 500, np.random.default_rng(7))
        first, second = (train_map(points, labels, hidden=(8,), steps=20) for _ in range(2))
        for a, b in zip(first.weights, second.weights, strict=True):
            assert (a == b).all()

    def test_labels_are_those_of_the_grown_bodies(self) -> None:
        points, labels = sample_labelled_points(
            [BALL, TABLE], 5000, np.random.default_rng(8), inflation=0.03
        )
        assert points.shape == (5000, 3)
        distance = np.minimum(
            np.linalg.norm(points - BALL.position, axis=1) - BALL.size[0], points[:, 2]
        )
        assert (labels == (distance <= 0.03)).all()
        assert 0.1 < labels.mean() < 0.9

    @pytest.mark.parametrize("label", [0, 1])
    def test_points_of_one_class_are_refused(self, label: int) -> None:
        points = np.random.default_rng(9).uniform(size=(100, 3))
        with pytest.raises(ValueError, match=f"free and occupied points, got {100 * label} occ"):
            train_map(points, np.full(100, label))

    @pytest.mark.parametrize(
        ("points", "labels", "message"),
        [
            (np.full((4, 3), np.nan), [0, 1, 0, 1], "points must be finite"),
            (np.zeros((4, 2)), [0, 1, 0, 1], r"points must have shape \(\.\.\., 3\)"),
            (np.zeros((4, 3)), [0, 1, 0], r"\(4, 3\) and \(3,\)"),
            (np.zeros((4, 3)), [0, 1, 0, 2], "labels must be 0 or 1, got 2"),
            (np.zeros((4, 3)), [0, 1, 0, 1], "points must not all be the same"),
        ],
    )
    def test_impossible_data_are_refused(self, points: Any, labels: Any, message: str) -> None:
        with pytest.raises(ValueError, match=message):
            train_map(points, labels)

    def test_impossible_settings_are_refused(self) -> None:
        points, labels = sample_labelled_points([BALL], 100, np.random.default_rng(10))
        with pytest.raises(ValueError, match="must be positive"):
            train_map(points, labels, steps=0)
        with pytest.raises(ValueError, match="must be positive"):
            train_map(points, labels, hidden=())
        with pytest.raises(ValueError, match="inflation must not be negative"):
            train_map(points, labels, inflation=-0.1, steps=1)

    def test_scenes_with_nothing_to_learn_are_refused(self) -> None:
        far = Obstacle(shape="sphere", position=(9.0, 0.0, 0.0), size=(0.1, 0.1, 0.1))
        for obstacles in ((), (far,)):
            with pytest.raises(ValueError, match="obstacles must hold a body in the workspace"):
                sample_labelled_points(obstacles, 10, np.random.default_rng(0))


def _networks() -> ShapeNetworks:
    return default_networks()


def _point_network() -> PointNetwork:
    points, labels = sample_labelled_points([BALL], 100, np.random.default_rng(11))
    return train_map(points, labels, hidden=(4, 4), steps=2, inflation=0.01)


@pytest.mark.parametrize("make", [_networks, _point_network])
class TestFiles:
    def test_loading_gives_back_what_was_saved(
        self, make: Callable[[], Any], tmp_path: Path
    ) -> None:
        saved = make()
        saved.save(tmp_path / "network.npz")
        loaded = type(saved).load(tmp_path / "network.npz")
        for f in dataclasses.fields(saved):
            a, b = getattr(saved, f.name), getattr(loaded, f.name)
            if isinstance(a, tuple):
                assert all((x == y).all() for x, y in zip(a, b, strict=True))
            else:
                assert np.array_equal(a, b)

    def test_damaged_files_are_refused(self, make: Callable[[], Any], tmp_path: Path) -> None:
        saved = make()
        path = tmp_path / "network.npz"
        saved.save(path)
        content = path.read_bytes()
        flipped = bytearray(content)
        flipped[content.index(b"header.npy") + 60] ^= 0xFF
        for damaged in (b"", b"no archive", content[: len(content) // 2], bytes(flipped)):
            path.write_bytes(damaged)
            with pytest.raises(ValueError, match=r"network\.npz is damaged"):
                type(saved).load(path)

    def test_whatever_byte_is_flipped_there_is_a_result_or_a_clear_error(
        self, make: Callable[[], Any], tmp_path: Path
    ) -> None:
        saved = make()
        path = tmp_path / "network.npz"
        saved.save(path)
        content = path.read_bytes()
        refused = 0
        for position in range(0, len(content), 7):
            flipped = bytearray(content)
            flipped[position] ^= 0xFF
            path.write_bytes(flipped)
            # Any other exception fails the test; some bytes of a zip file mean nothing.
            try:
                type(saved).load(path)
            except ValueError:
                refused += 1
        assert refused > 0.5 * len(content) / 7

    def test_other_versions_and_formats_are_refused(
        self, make: Callable[[], Any], tmp_path: Path
    ) -> None:
        saved = make()
        path = tmp_path / "network.npz"
        saved.save(path)
        with np.load(path) as archive:
            arrays = dict(archive)
        header = json.loads(str(arrays["header"]))
        for change in ({"version": 99}, {"format": "else"}):
            arrays["header"] = np.array(json.dumps({**header, **change}))
            np.savez(path, **arrays)
            with pytest.raises(ValueError, match=r"network\.npz must have the header.*got"):
                type(saved).load(path)

    def test_pickled_objects_are_refused(self, make: Callable[[], Any], tmp_path: Path) -> None:
        path = tmp_path / "network.npz"
        np.savez(path, header=np.array([{"format": 1}], dtype=object))
        with pytest.raises(ValueError, match=r"network\.npz is damaged"):
            type(make()).load(path)

    def test_missing_arrays_are_refused(self, make: Callable[[], Any], tmp_path: Path) -> None:
        saved = make()
        path = tmp_path / "network.npz"
        saved.save(path)
        with np.load(path) as archive:
            header = archive["header"]
        np.savez(path, header=header)
        with pytest.raises(ValueError, match=r"network\.npz"):
            type(saved).load(path)

    def test_missing_files_are_said_to_be_missing(
        self, make: Callable[[], Any], tmp_path: Path
    ) -> None:
        with pytest.raises(FileNotFoundError):
            type(make()).load(tmp_path / "absent.npz")
