"""The chain of the planner against the kinematics of the arm, autograd and plain trigonometry."""

import dataclasses

import numpy as np
import pytest
import torch

from smp_gym.robot import forward_kernels as compiled
from smp_gym.robot import kinematics
from smp_gym.robot.kinematics import SphereSet
from smp_planner.collision.robot_model import RobotModel, jaco_model


def planar_arm(spheres=None, pairs=(), lengths=(0.5, 0.3)):
    """Two joints about z, links along x; the end effector is at the tip of the second."""
    second = np.eye(4)
    second[0, 3] = lengths[0]
    tip = np.eye(4)
    tip[0, 3] = lengths[1]
    if spheres is None:
        spheres = SphereSet(np.array([2]), np.array([[lengths[1], 0.0, 0.0]]), np.array([0.05]))
    return RobotModel(
        base=np.eye(4),
        joint_origins=np.stack([np.eye(4), second]),
        end_effector=tip,
        lower=np.full(2, -3.0),
        upper=np.full(2, 3.0),
        velocity=np.array([1.0, 2.0]),
        spheres=spheres,
        collision_pairs=np.array(pairs, np.int64).reshape(-1, 2),
    )


@pytest.fixture(scope="module")
def robot():
    return jaco_model(kinematics.finger_spheres(np.array([0.3, 0.4, 0.2, 0.1])))


@pytest.fixture(scope="module")
def configurations():
    return np.random.default_rng(1).uniform(-4.0, 4.0, (5, 7, 6))


def test_sine_and_cosine():
    angles = np.concatenate([np.linspace(-30.0, 30.0, 10_001), np.arange(-8, 9) * np.pi / 4])
    sine, cosine = np.empty_like(angles), np.empty_like(angles)
    compiled.sine_cosine(angles, sine, cosine)
    np.testing.assert_allclose(sine, np.sin(angles), rtol=0, atol=5e-15)
    np.testing.assert_allclose(cosine, np.cos(angles), rtol=0, atol=5e-15)


def test_link_transforms_are_those_of_the_arm(robot, configurations):
    poses = robot.link_transforms(torch.as_tensor(configurations)).numpy()
    expected = kinematics.link_transforms(configurations)
    np.testing.assert_allclose(poses, expected, rtol=0, atol=1e-12)


def test_sphere_centers_are_those_of_the_arm(robot, configurations):
    centers = robot.sphere_centers(torch.as_tensor(configurations)).numpy()
    expected = kinematics.sphere_centers(configurations, robot.spheres)
    np.testing.assert_allclose(centers, expected, rtol=0, atol=1e-12)


def test_compiled_loops_place_spheres_as_the_arm_does(robot, configurations):
    flat = configurations.reshape(-1, 6)
    angles = np.ascontiguousarray(flat.T)
    rotation, position = np.empty((7, 3, 3, len(flat))), np.empty((7, 3, len(flat)))
    placed = np.empty((len(robot.link), 3, len(flat)))
    compiled.chain(
        np.sin(angles), np.cos(angles), robot.base, robot.joint_origins, rotation, position
    )
    compiled.place(rotation, position, robot.link, robot.center, placed)
    expected = kinematics.sphere_centers(flat, robot.spheres)
    np.testing.assert_allclose(np.moveaxis(placed, 2, 0), expected, rtol=0, atol=1e-12)


def test_link_transforms_keep_the_dtype(robot):
    assert robot.link_transforms(torch.zeros(6, dtype=torch.float32)).dtype == torch.float32


def test_carried_points_and_their_jacobian(robot, configurations):
    point = np.array([0.03, -0.02, 0.05])
    points, jacobians = robot.carried_points(configurations, point)
    pose = kinematics.end_effector_pose(configurations)
    expected = pose[..., :3, :3] @ point + pose[..., :3, 3]
    np.testing.assert_allclose(points, expected, rtol=0, atol=1e-12)

    def carry(q):
        pose = robot.link_transforms(q)[-1]
        return pose[:3, :3] @ torch.as_tensor(robot.carried(point)) + pose[:3, 3]

    q = torch.as_tensor(configurations[2, 3])
    jacobian = torch.autograd.functional.jacobian(carry, q).numpy()
    np.testing.assert_allclose(jacobians[2, 3], jacobian, rtol=0, atol=1e-12)


def test_one_configuration_has_no_batch_axes():
    points, jacobians = planar_arm().carried_points(np.array([0.3, 0.4]), np.zeros(3))
    x = 0.5 * np.cos(0.3) + 0.3 * np.cos(0.7)
    y = 0.5 * np.sin(0.3) + 0.3 * np.sin(0.7)
    np.testing.assert_allclose(points, [x, y, 0.0], atol=1e-15)
    np.testing.assert_allclose(
        jacobians, [[-y, -0.3 * np.sin(0.7)], [x, 0.3 * np.cos(0.7)], [0.0, 0.0]], atol=1e-15
    )


def test_link_pairs_are_the_collision_pairs_by_link():
    rng = np.random.default_rng(2)
    link = rng.integers(0, 3, 12)
    spheres = SphereSet(link, rng.normal(size=(12, 3)), rng.uniform(0.01, 0.1, 12))
    pairs = np.array([(i, j) for i in range(12) for j in range(12) if i < j and link[i] != link[j]])
    flip = rng.random(len(pairs)) < 0.5
    pairs[flip] = pairs[flip, ::-1]
    found = planar_arm(spheres, pairs).link_pairs
    assert {frozenset(p) for p in found.pairs.tolist()} == {frozenset(p) for p in pairs.tolist()}
    assert found.sizes.sum() == len(pairs) == len(found.pairs)
    for (first, second, begin), size in zip(found.groups, found.sizes, strict=True):
        members = link[found.pairs[begin : begin + size]]
        assert (members == (first, second)).all()
    for s in range(12):
        reach = np.linalg.norm(spheres.center[s] - found.ball_center[link[s]]) + spheres.radius[s]
        assert reach <= found.ball_radius[link[s]] + 1e-12


def test_a_robot_without_pairs_has_no_groups():
    found = planar_arm().link_pairs
    assert found.groups.shape == (0, 3)
    assert found.pairs.shape == (0, 2)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"base": np.eye(3)}, r"base must have shape \(4, 4\), got \(3, 3\)"),
        ({"lower": np.array([0.0, np.nan])}, "lower must be finite"),
        ({"lower": np.array([0.0, 4.0])}, "must be below upper"),
        ({"velocity": np.array([1.0, 0.0])}, "velocity must be positive"),
        ({"collision_pairs": np.array([[0, 1]])}, "must index the 1 spheres"),
        (
            {"spheres": SphereSet(np.array([3]), np.zeros((1, 3)), np.ones(1))},
            "on links 0 to 2, got 3 to 3",
        ),
        (
            {"spheres": SphereSet(np.array([2]), np.zeros((1, 3)), np.array([-0.1]))},
            "radius must not be negative",
        ),
    ],
)
def test_a_bad_robot_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(planar_arm(), **change)


def test_bad_arguments_are_refused():
    robot = planar_arm()
    with pytest.raises(ValueError, match=r"configurations must have shape \(..., 2\), got \(3,\)"):
        robot.carried_points(np.zeros(3), np.zeros(3))
    with pytest.raises(ValueError, match="configurations must be finite"):
        robot.carried_points(np.array([0.0, np.nan]), np.zeros(3))
    with pytest.raises(ValueError, match=r"point must have shape \(3,\)"):
        robot.carried_points(np.zeros(2), np.zeros(2))
    with pytest.raises(ValueError, match="configurations must have shape"):
        robot.link_transforms(torch.zeros(4, 3))


def test_no_posture_brings_spheres_nearer_than_their_least_gap():
    robot = jaco_model(kinematics.finger_spheres(np.array([0.3, 0.4, 0.2, 0.1])))
    pairs = robot.link_pairs.pairs
    gaps = robot.least_gaps
    known = np.isfinite(gaps)
    between = np.abs(np.diff(robot.link[pairs], axis=1)[:, 0])
    np.testing.assert_array_equal(known, between <= 2)
    assert known.any()
    angles = np.random.default_rng(2).uniform(-np.pi, np.pi, (20_000, robot.joints))
    centers = robot.sphere_centers(torch.as_tensor(angles)).numpy()
    apart = np.linalg.norm(centers[:, pairs[:, 0]] - centers[:, pairs[:, 1]], axis=-1).min(axis=0)
    found = (apart - robot.radius[pairs].sum(axis=1))[known]
    assert (gaps[known] <= found + 1e-9).all()
    assert (gaps[known] > found - 0.005).all()
