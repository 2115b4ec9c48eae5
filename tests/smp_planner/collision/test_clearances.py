"""Clearances against the plain chain, the exact distance and finite differences."""

import numpy as np
import pytest
import torch

from smp_gym.robot import kinematics
from smp_gym.scene import TABLE, Obstacle
from smp_planner.collision.clearances import JointLimitClearances, SphereClearances
from smp_planner.collision.costs import CollisionCost
from smp_planner.collision.robot_model import jaco_model
from smp_planner.occupancy.grid import bake_analytic

OBSTACLES = (
    TABLE,
    Obstacle(shape="box", position=(0.4, 0.1, 0.2), size=(0.05, 0.06, 0.2)),
    Obstacle(shape="sphere", position=(0.2, -0.4, 0.5), size=(0.06, 0.06, 0.06)),
)


@pytest.fixture(scope="module")
def spheres():
    robot = jaco_model(kinematics.finger_spheres(np.array([0.3, 0.4, 0.2, 0.1])))
    return SphereClearances(robot, bake_analytic(OBSTACLES, spacing=0.03))


@pytest.fixture(scope="module")
def limits():
    robot = jaco_model()
    return JointLimitClearances(robot.lower, robot.upper)


def configurations(count=150):
    robot = jaco_model()
    return np.random.default_rng(5).uniform(-1.5, 1.5, (count, robot.joints)) + 2.0


def test_clearances_are_distances_at_the_plain_chain_s_spheres_less_radii(spheres):
    """Configurations are more than a block of the kernel, and no whole number of blocks."""
    q, robot = configurations(), spheres.robot
    moves = robot.link > 0
    centers = robot.sphere_centers(torch.from_numpy(q)).numpy()[:, moves]
    expected = spheres.grid.query(centers) - robot.radius[moves]
    np.testing.assert_allclose(spheres(q), expected, atol=1e-9)
    assert expected.shape[1] == CollisionCost(robot, spheres.grid).summed_spheres < len(robot.link)
    assert (expected < 0.0).any()
    assert (expected > 0.05).any()


def test_gradients_of_spheres_are_those_of_autograd_through_the_plain_chain(spheres):
    q, robot = configurations(), spheres.robot
    slopes = np.random.default_rng(0).normal(size=spheres(q).shape)
    slopes[:, ::3] = 0.0
    given = torch.from_numpy(q).requires_grad_()
    centers = robot.sphere_centers(given)[:, torch.from_numpy(robot.link > 0)]
    away = spheres.grid.query_with_gradient(centers.detach().numpy())[1]
    (centers * torch.from_numpy(slopes[..., None] * away)).sum().backward()
    np.testing.assert_allclose(spheres.pull_back(q, slopes), given.grad.numpy(), atol=1e-9)


@pytest.mark.parametrize("name", ["spheres", "limits"])
def test_gradients_by_finite_differences(name, request):
    clearances = request.getfixturevalue(name)
    q = configurations(40)
    slopes = np.random.default_rng(1).normal(size=clearances(q).shape)
    found = clearances.pull_back(q, slopes)
    step = 1e-6
    for joint in range(q.shape[1]):
        change = step * np.eye(q.shape[1])[joint]
        by_clearance = (clearances(q + change) - clearances(q - change)) / (2 * step)
        expected = (slopes * by_clearance).sum(axis=1)
        # The map has an edge where a sphere goes from one cell to the next; few are that near.
        agree = np.isclose(found[:, joint], expected, atol=1e-5)
        assert agree.mean() > 0.95


def test_limits_are_kept_where_nothing_is_negative(limits):
    inside = (limits.lower + limits.upper) / 2
    assert (limits(inside[None]) > 0.0).all()
    beyond = inside.copy()
    beyond[2] = limits.upper[2] + 0.1
    found = limits(beyond[None])[0]
    assert found[6 + 2] == pytest.approx(-0.1)
    assert (np.delete(found, 8) > 0.0).all()


@pytest.mark.parametrize("name", ["spheres", "limits"])
@pytest.mark.parametrize(
    ("q", "said"),
    [
        (np.zeros((3, 5)), "configurations must have shape"),
        (np.zeros(6), "configurations must have shape"),
        (np.full((2, 6), np.nan), "finite"),
    ],
)
def test_bad_configurations_are_named(name, q, said, request):
    clearances = request.getfixturevalue(name)
    with pytest.raises(ValueError, match=said):
        clearances(q)
    with pytest.raises(ValueError, match=said):
        clearances.pull_back(q, np.zeros((len(q), 12)))


@pytest.mark.parametrize("name", ["spheres", "limits"])
def test_bad_slopes_are_named(name, request):
    clearances = request.getfixturevalue(name)
    with pytest.raises(ValueError, match=r"slopes must have shape \(2, \d+\), got \(2, 1\)"):
        clearances.pull_back(configurations(2), np.zeros((2, 1)))
