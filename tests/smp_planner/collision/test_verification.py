"""The exact check against dense sampling, a physics engine and geometry done by hand."""

import dataclasses

import numpy as np
import pybullet
import pytest
from pybullet_utils.bullet_client import BulletClient
from scipy.spatial.transform import Rotation

from smp_gym.geometry.distance import PackedObstacles, signed_distance
from smp_gym.robot import kinematics
from smp_gym.robot.kinematics import SphereSet
from smp_gym.scene import TABLE, Obstacle
from smp_planner.collision.robot_model import jaco_model
from smp_planner.collision.verification import (
    CLEARANCE_TOLERANCE,
    check_collisions,
    minimum_duration,
    verify,
    within_joint_limits,
)

TILTED = tuple(Rotation.from_euler("xyz", [0.4, 0.7, -0.3]).as_quat().tolist())
OBSTACLES = (
    TABLE,
    Obstacle(shape="box", position=(0.45, 0.1, 0.2), quaternion=TILTED, size=(0.05, 0.06, 0.15)),
    Obstacle(shape="sphere", position=(0.2, -0.4, 0.5), size=(0.06, 0.06, 0.06)),
    Obstacle(
        shape="cylinder", position=(-0.3, 0.2, 0.6), quaternion=TILTED, size=(0.04, 0.04, 0.1)
    ),
)


@pytest.fixture(scope="module")
def robot():
    return jaco_model(kinematics.finger_spheres(np.array([0.3, 0.4, 0.2, 0.1])))


@pytest.fixture(scope="module")
def paths(robot):
    """Smooth paths from one posture over the table to others, (24, 15, 6) rad."""
    rng = np.random.default_rng(7)
    start = np.array([0.3, 3.0, 1.5, 0.0, 2.5, 0.0]) + 0.3 * rng.normal(size=(24, 1, 6))
    phase = np.linspace(0.0, 1.0, 15)[None, :, None]
    return start + rng.normal(size=(24, 1, 6)) * [0.8, 0.5, 0.5, 1.0, 1.0, 1.0] * phase**2


def dense(paths, parts):
    """Return paths with `parts` linear parts in each segment."""
    share = np.arange(parts)[:, None] / parts
    steps = paths[:, :-1, None] + share * np.diff(paths, axis=1)[:, :, None]
    return np.concatenate([steps.reshape(len(paths), -1, paths.shape[2]), paths[:, -1:]], axis=1)


@pytest.fixture(scope="module")
def rod(pointer):
    """A pointer of half a metre."""
    return pointer(length=0.5, radius=0.05, velocity=0.5)


def test_clearance_is_that_of_dense_sampling(robot, paths):
    moving = robot.link > 0
    centers = kinematics.sphere_centers(dense(paths, 60), robot.spheres)[:, :, moving]
    distance = signed_distance(centers, OBSTACLES) - robot.radius[moving]
    expected = distance.min(axis=(1, 2))
    check = check_collisions(paths, robot, OBSTACLES)
    # Sampling misses the minimum by at most half the path between two samples, here 3 mm.
    assert (check.clearance <= expected + CLEARANCE_TOLERANCE).all()
    assert (check.clearance >= expected - 3e-3).all()
    clear = (np.abs(expected) > 5e-3) & check.self_free
    np.testing.assert_array_equal(check.free[clear], expected[clear] > 0.0)
    assert (expected < 0.0).any()
    assert (expected > 0.0).any()


def test_self_collision_is_that_of_dense_sampling(robot):
    rng = np.random.default_rng(8)
    paths = rng.uniform(robot.lower, robot.upper, (60, 4, 6))
    paths = paths[:, :1] + 0.15 * (paths - paths[:, :1])
    centers = kinematics.sphere_centers(dense(paths, 100), robot.spheres)
    first, second = robot.collision_pairs.T
    between = np.linalg.norm(centers[:, :, first] - centers[:, :, second], axis=-1)
    gap = (between - robot.radius[first] - robot.radius[second]).min(axis=(1, 2))
    check = check_collisions(paths, robot, ())
    decided = np.abs(gap - CLEARANCE_TOLERANCE) > 2e-3
    np.testing.assert_array_equal(check.self_free[decided], gap[decided] > 0.0)
    np.testing.assert_array_equal(check.free, check.self_free)
    assert check.self_free.any()
    assert not check.self_free.all()


def test_clearance_is_that_of_the_physics_engine(robot):
    """Spheres against bodies of PyBullet, one configuration at a time."""
    rng = np.random.default_rng(9)
    configurations = np.array([0.3, 3.0, 1.5, 0.0, 2.5, 0.0]) + 0.5 * rng.normal(size=(6, 6))
    moving = np.flatnonzero(robot.link > 0)
    found = check_collisions(configurations[:, None], robot, OBSTACLES).clearance
    client = BulletClient(pybullet.DIRECT)
    bodies = []
    for obstacle in OBSTACLES:
        if obstacle.shape == "box":
            shape = client.createCollisionShape(pybullet.GEOM_BOX, halfExtents=obstacle.size)
        elif obstacle.shape == "sphere":
            shape = client.createCollisionShape(pybullet.GEOM_SPHERE, radius=obstacle.size[0])
        else:
            shape = client.createCollisionShape(
                pybullet.GEOM_CYLINDER, radius=obstacle.size[0], height=2 * obstacle.size[2]
            )
        bodies.append(
            client.createMultiBody(
                0, shape, basePosition=obstacle.position, baseOrientation=obstacle.quaternion
            )
        )
    balls = [
        client.createMultiBody(
            0, client.createCollisionShape(pybullet.GEOM_SPHERE, radius=robot.radius[s])
        )
        for s in moving
    ]
    for configuration, clearance in zip(configurations, found, strict=True):
        centers = kinematics.sphere_centers(configuration, robot.spheres)[moving]
        for ball, center in zip(balls, centers, strict=True):
            client.resetBasePositionAndOrientation(ball, center, (0, 0, 0, 1))
        distances = [
            point[8]
            for ball in balls
            for body in bodies
            for point in client.getClosestPoints(ball, body, distance=0.5)
        ]
        assert clearance == pytest.approx(min(distances), abs=1e-3)
    client.disconnect()
    assert (found > 0.0).any()


def test_what_lies_only_between_two_steps_is_found(rod):
    plate = Obstacle(shape="box", position=(0.5, 0.0, 0.0), size=(0.2, 0.001, 0.2))
    path = np.array([[[-1.0], [1.0]], [[-1.0], [-0.2]]])
    check = check_collisions(path, rod, (plate,))
    assert check.clearance[0] == pytest.approx(-0.05 - 0.001, abs=CLEARANCE_TOLERANCE)
    assert check.clearance[1] == pytest.approx(
        0.5 * np.sin(0.2) - 0.05 - 0.001, abs=CLEARANCE_TOLERANCE
    )
    np.testing.assert_array_equal(check.free, [False, True])


def test_self_contact_between_two_steps_is_found(rod):
    """A sphere of the mount stands in the path of the one on the rod, between all the steps."""
    radius = np.array([0.02, 0.05])
    for at, free in ((0.5 + 0.07 - 0.01, False), (0.5 + 0.07 + 0.01, True)):
        center = np.array([[at, 0.0, 0.0], [0.5, 0.0, 0.0]])
        robot = dataclasses.replace(
            rod, spheres=SphereSet(np.array([0, 1]), center, radius), collision_pairs=[[0, 1]]
        )
        check = check_collisions(np.array([[[-1.0], [1.0]]]), robot, ())
        assert check.self_free.tolist() == check.free.tolist() == [free]


def test_a_path_is_free_only_if_it_is_so_for_certain(rod):
    """A ball on the circle that the rod's sphere draws leaves a gap of 0.4 and 1.6 tolerances."""
    for gap, free in ((0.4 * CLEARANCE_TOLERANCE, False), (1.6 * CLEARANCE_TOLERANCE, True)):
        # The closest approach, at 0.1234 rad, is at none of the steps.
        at = (0.5 + 0.05 + 0.1 + gap) * np.array([np.cos(0.1234), np.sin(0.1234), 0.0])
        ball = Obstacle(shape="sphere", position=tuple(at.tolist()), size=(0.1, 0.1, 0.1))
        path = np.linspace(-1.0, 1.0, 7)[None, :, None]
        check = check_collisions(path, rod, (ball,), CLEARANCE_TOLERANCE / 4)
        assert gap <= check.clearance[0] + 1e-12 <= gap + CLEARANCE_TOLERANCE / 4 + 1e-12
        assert (check_collisions(path, rod, (ball,)).free == free).all()


def test_more_steps_on_the_same_path_change_nothing(robot, paths):
    coarse = check_collisions(paths, robot, OBSTACLES)
    fine = check_collisions(dense(paths, 8), robot, OBSTACLES)
    np.testing.assert_allclose(coarse.clearance, fine.clearance, rtol=0, atol=CLEARANCE_TOLERANCE)


def test_without_obstacles_the_clearance_is_infinite(robot, paths):
    check = check_collisions(paths, robot, ())
    assert (check.clearance == np.inf).all()
    np.testing.assert_array_equal(check.free, check.self_free)


def test_packed_obstacles_are_taken(robot, paths):
    packed = check_collisions(paths, robot, PackedObstacles.of(OBSTACLES))
    np.testing.assert_array_equal(
        packed.clearance, check_collisions(paths, robot, OBSTACLES).clearance
    )


def test_the_mount_is_not_checked(rod):
    spheres = SphereSet(
        np.array([0, 1]), np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]]), np.array([0.1, 0.05])
    )
    fixed = dataclasses.replace(rod, spheres=spheres)
    ball = Obstacle(shape="sphere", position=(0.0, 0.0, 0.0), size=(0.1, 0.1, 0.1))
    check = check_collisions(np.zeros((1, 2, 1)), fixed, (ball,))
    assert check.clearance[0] == pytest.approx(0.5 - 0.05 - 0.1)


def test_each_trajectory_is_checked_on_its_own(robot, paths):
    together = check_collisions(paths, robot, OBSTACLES)
    for p in (0, 7, 23):
        alone = check_collisions(paths[p : p + 1], robot, OBSTACLES)
        assert alone.clearance[0] == together.clearance[p]
        assert alone.free[0] == together.free[p]


def test_durations_by_hand():
    velocity = np.array([0.5, 0.25])
    path = np.array([[[0.0, 0.0], [0.5, 0.1], [0.4, -0.4]]])
    np.testing.assert_allclose(minimum_duration(path, velocity, 1.0), [4.0])
    np.testing.assert_allclose(minimum_duration(path, velocity, 0.5), [8.0])


def test_duration_does_not_depend_on_the_number_of_steps(paths):
    velocity = kinematics.JOINT_VELOCITY
    np.testing.assert_allclose(
        minimum_duration(dense(paths, 5), velocity), minimum_duration(paths, velocity)
    )


def test_one_step_takes_no_time():
    assert minimum_duration(np.zeros((3, 1, 2)), np.ones(2)).tolist() == [0.0] * 3


def test_joint_limits(robot):
    middle = (robot.lower + robot.upper) / 2
    paths = np.tile(middle, (3, 5, 1))
    # Rounding is no violation.
    paths[0, 2] = robot.upper + 5e-7
    paths[1, 3, 2] = robot.lower[2] - 2e-6
    paths[2, 4, 5] = robot.upper[5] + 2e-6
    assert within_joint_limits(paths, robot).tolist() == [True, False, False]


def test_verification_says_what_is_executable(rod):
    turns = np.array([[[0.0], [1.0]], [[0.0], [2.0]], [[2.5], [3.1]]])
    ball = Obstacle(shape="sphere", position=(0.5, 0.0, 0.0), size=(0.01, 0.01, 0.01))
    result = verify(turns, rod, (ball,), duration_limit=3.0)
    np.testing.assert_allclose(result.duration, np.array([1.0, 2.0, 0.6]) / (0.9 * 0.5))
    assert result.within_limits.tolist() == [True, True, False]
    assert result.executable.tolist() == [True, False, False]
    assert result.collision_free.tolist() == [False, False, True]
    assert result.self_collision_free.all()
    assert result.clearance[0] == pytest.approx(-0.06)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda r: check_collisions(np.zeros((2, 3)), r, ()), r"shape \(P, T, 1\), got \(2, 3\)"),
        (lambda r: check_collisions(np.full((1, 1, 1), np.nan), r, ()), "got nan in particle 0"),
        (lambda r: check_collisions(np.zeros((1, 1, 1)), r, (), 0.0), "tolerance must be positive"),
        (lambda r: within_joint_limits(np.zeros((1, 1, 2)), r), r"shape \(P, T, 1\)"),
        (lambda r: minimum_duration(np.zeros((1, 2, 1)), np.zeros(1)), "velocity must be"),
        (lambda r: minimum_duration(np.zeros((1, 2, 1)), np.ones(2)), r"shape \(P, T, 2\)"),
        (lambda r: minimum_duration(np.zeros((1, 2, 1)), np.ones(1), 0.0), "fraction must be"),
        (lambda r: verify(np.zeros((1, 2, 1)), r, (), 0.0), "duration_limit must be positive"),
    ],
)
def test_bad_input_is_refused(rod, call, message):
    with pytest.raises(ValueError, match=message):
        call(rod)
