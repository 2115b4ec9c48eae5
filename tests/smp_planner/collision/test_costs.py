"""Costs and gradients against autograd through plain tensors, finite differences and geometry."""

import dataclasses

import numpy as np
import pytest
import torch

from smp_gym.robot import kinematics
from smp_gym.robot.kinematics import SphereSet
from smp_gym.scene import TABLE, Obstacle
from smp_planner.collision import autograd, costs
from smp_planner.collision.autograd import by_autograd
from smp_planner.collision.robot_model import jaco_model
from smp_planner.occupancy.grid import DistanceGrid, bake_analytic
from smp_planner.planning.settings import PlanSettings
from smp_planner.planning.tool_constraints import Reaching, ToolPath
from smp_planner.planning.tool_goals import GoalRegion, ToolViaPoint

OBSTACLES = (
    TABLE,
    Obstacle(shape="box", position=(0.4, 0.1, 0.2), size=(0.05, 0.06, 0.2)),
    Obstacle(shape="sphere", position=(0.2, -0.4, 0.5), size=(0.06, 0.06, 0.06)),
    Obstacle(shape="cylinder", position=(-0.3, 0.2, 0.4), size=(0.04, 0.04, 0.1)),
)


@pytest.fixture(scope="module")
def robot():
    return jaco_model(kinematics.finger_spheres(np.array([0.3, 0.4, 0.2, 0.1])))


@pytest.fixture(scope="module")
def grid():
    return bake_analytic(OBSTACLES, spacing=0.04)


def trajectories(robot, particles=6, steps=12, seed=3):
    """Smooth paths all over the range of the joints, so that many spheres are in collision."""
    rng = np.random.default_rng(seed)
    ends = rng.uniform(robot.lower, robot.upper, (2, particles, 1, robot.joints))
    phase = np.linspace(0.0, 1.0, steps)[None, :, None]
    return ends[0] + 0.4 * (ends[1] - ends[0]) * phase**2


def assert_agrees(cost, oracle, q):
    """Value and gradient are those of a differentiable function, up to single precision."""
    value, gradient = cost(q)
    assert value.shape == (len(q),)
    assert gradient.shape == q.shape
    expected_value, expected_gradient = by_autograd(oracle, torch.as_tensor(q))
    largest = np.abs(expected_gradient).max()
    assert largest > 0.0
    assert (expected_value > 0.1).any()
    np.testing.assert_allclose(value, expected_value, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(gradient, expected_gradient, rtol=0, atol=1e-5 * largest)


def assert_slope(cost, q, step=1e-3):
    """Along random directions the value changes as the gradient says."""
    directions = np.random.default_rng(4).normal(size=(8, *q.shape))
    expected = np.stack(
        [(cost(q + step * d)[0] - cost(q - step * d)[0]) / (2 * step) for d in directions]
    )
    found = (directions * cost(q)[1]).sum(axis=(2, 3))
    np.testing.assert_allclose(found, expected, rtol=0, atol=0.03 * np.abs(expected).max())


@pytest.mark.parametrize(("edge_width", "margin"), [(0.05, 0.01), (0.01, 0.01), (0.02, -0.01)])
def test_collision_cost_is_eq_12(robot, grid, edge_width, margin):
    cost = costs.CollisionCost(robot, grid, scale=0.7)
    assert_agrees(
        lambda q: cost(q, edge_width, margin),
        lambda q: autograd.map_collision(cost, q, edge_width, margin),
        trajectories(robot, particles=13, steps=17),
    )


def test_slopes_by_finite_differences(robot, grid):
    collision, own = costs.CollisionCost(robot, grid), costs.SelfCollisionCost(robot, 0.02)
    # Few steps: where a sphere goes from one cell to the next the interpolant has an edge, which
    # finite differences must not meet.
    assert_slope(lambda q: collision(q, 0.05, 0.0), trajectories(robot, 8, 1))
    assert_slope(own, trajectories(robot, 20, 1))


def test_a_part_of_a_set_costs_what_it_does_alone(robot, grid):
    q = trajectories(robot, particles=9, steps=31)
    for cost in path_costs(robot, grid).values():
        value, gradient = cost(q)
        for part in (slice(0, 4), slice(4, 5), slice(5, 9)):
            alone = cost(q[part])
            # Some processors sum the last few of a loop in another order.
            np.testing.assert_allclose(alone[0], value[part], rtol=1e-5, atol=1e-6)
            np.testing.assert_allclose(alone[1], gradient[part], rtol=1e-4, atol=2e-5)


def test_a_stretch_costs_what_its_steps_do(robot, grid):
    q = trajectories(robot, particles=5, steps=30)
    cost = costs.CollisionCost(robot, grid)
    value, gradient = np.full(5, 2.0), np.ones(q.shape)
    cost.add_stretch(q, 7, 19, 0.03, 0.01, 3.0, value, gradient)
    expected, slope = cost(np.ascontiguousarray(q[:, 7:19]), 0.03, 0.01)
    scale = 3.0 / costs.steps_scale(12)
    np.testing.assert_allclose(value, 2.0 + scale * expected)
    np.testing.assert_allclose(gradient[:, 7:19], 1.0 + scale * slope)
    assert (gradient[:, :7] == 1.0).all()
    assert (gradient[:, 19:] == 1.0).all()


def test_configurations_that_are_no_numbers_harm_nothing(robot, grid):
    q = trajectories(robot, particles=4, steps=9)
    spoiled = q.copy()
    spoiled[1, 3, 2], spoiled[2] = np.nan, np.inf
    for name, cost in compiled_costs(robot, grid).items():
        results = []
        for given in (q, spoiled):
            value, gradient = np.zeros(4), np.zeros(q.shape)
            cost(given, value, gradient)
            results.append((value, gradient))
        for of_all, of_spoiled in zip(*results, strict=True):
            # Some processors sum the last few of a loop in another order.
            np.testing.assert_allclose(
                of_spoiled[[0, 3]], of_all[[0, 3]], rtol=1e-4, atol=2e-5, err_msg=name
            )


def test_nothing_near_costs_exactly_nothing(robot):
    far = bake_analytic([Obstacle(shape="sphere", position=(9.0, 0.0, 0.0), size=(0.1,) * 3)])
    value, gradient = costs.CollisionCost(robot, far)(trajectories(robot), 0.05, 0.01)
    assert (value == 0.0).all()
    assert (gradient == 0.0).all()


def test_the_mount_may_stand_on_the_table(robot):
    grid = bake_analytic([TABLE])
    base = SphereSet(np.array([0]), np.array([[0.0, 0.0, -0.05]]), np.array([0.1]))
    mount = dataclasses.replace(robot, spheres=base, collision_pairs=np.empty((0, 2), np.int64))
    cost = costs.CollisionCost(mount, grid)
    value, _ = cost(trajectories(robot))
    assert (value == 0.0).all()
    assert cost.summed_spheres == 0


def test_collision_cost_falls_along_its_gradient(robot, grid):
    cost = costs.CollisionCost(robot, grid)
    q = trajectories(robot)
    value, gradient = cost(q, 0.05, 0.01)
    norm = np.sqrt(np.square(gradient).sum(axis=(1, 2), keepdims=True))
    hit = value > 1.0
    after, _ = cost(q - 1e-3 * gradient / np.maximum(norm, 1e-12), 0.05, 0.01)
    assert hit.any()
    assert (after < value)[hit].all()


def test_spheres_outside_the_grid_take_its_boundary(robot):
    values = np.full((3, 3, 3), 0.02, np.float32)
    grid = DistanceGrid(np.full(3, 5.0), 0.1, values)
    cost = costs.CollisionCost(robot, grid)
    value, gradient = cost(trajectories(robot), 0.01, 0.0)
    # The map is constant, hence cut off where it is: no sphere is nearer than from far away.
    assert (value == 0.0).all()
    assert (gradient == 0.0).all()


def test_self_collision_cost(robot):
    cost = costs.SelfCollisionCost(robot, edge_width=0.01, margin=0.005)
    q = trajectories(robot, particles=40)
    assert_agrees(cost, lambda q: autograd.self_collision(cost, q), q)


def test_joint_limit_cost(robot):
    cost = costs.JointLimitCost(robot.lower, robot.upper, margin=0.1)
    q = trajectories(robot)
    q[0, 3, 1] = robot.upper[1] + 0.2
    q[1, 5, 2] = robot.lower[2] - 0.5
    assert_agrees(cost, lambda q: autograd.joint_limits(cost, q), q)
    inside = np.tile((robot.lower + robot.upper) / 2, (1, 4, 1))
    inside[0, 2, 4] = robot.upper[4] + 0.3
    np.testing.assert_allclose(cost(inside)[0], costs.REFERENCE_STEPS / 4 * 0.4**2)


def test_velocity_limit_cost(robot):
    q = trajectories(robot)
    limit = costs.VelocityLimitCost(robot.velocity, 2.0)
    assert_agrees(limit, lambda q: autograd.velocity_limits(limit, q), q)
    # Joint 0 turns evenly at 1.5 times what is allowed, the others stand.
    cost = costs.VelocityLimitCost(np.array([0.6, 0.6]), duration=10.0, fraction=0.9)
    line = np.zeros((1, 21, 2))
    line[0, :, 0] = np.linspace(0.0, -1.5 * 0.9 * 0.6 * 10.0, 21)
    np.testing.assert_allclose(cost(line)[0], costs.REFERENCE_STEPS * 0.5**2)
    value, gradient = cost(line / 1.6)
    assert value == 0.0
    assert (gradient == 0.0).all()


def compiled_costs(robot, grid):
    """What the costs compute with, unchecked: functions of trajectories, value and gradient."""
    collision = costs.CollisionCost(robot, grid)
    added = {
        "self-collision": costs.SelfCollisionCost(robot, 0.02, 0.01),
        "joint limits": costs.JointLimitCost(robot.lower, robot.upper, 0.5),
        "velocity limits": costs.VelocityLimitCost(robot.velocity, 1.0),
    }
    return {
        "collision": lambda q, v, g: collision.add_stretch(q, 0, q.shape[1], 0.03, 0.01, 1.0, v, g),
        **{name: lambda q, v, g, cost=cost: cost.add(q, 1.0, v, g) for name, cost in added.items()},
    }


def path_costs(robot, grid):
    collision = costs.CollisionCost(robot, grid)
    return {
        "collision": lambda q: collision(q, 0.03, 0.01),
        "self-collision": costs.SelfCollisionCost(robot, 0.02, 0.01),
        "joint limits": costs.JointLimitCost(robot.lower, robot.upper, 0.5),
        "velocity limits": costs.VelocityLimitCost(robot.velocity, 1.0),
    }


@pytest.mark.parametrize("name", ["collision", "self-collision", "joint limits", "velocity limits"])
def test_a_weight_means_the_same_for_every_number_of_steps(robot, grid, name):
    cost = path_costs(robot, grid)[name]
    coarse, _ = cost(trajectories(robot, particles=12, steps=200))
    fine, _ = cost(trajectories(robot, particles=12, steps=800))
    assert (coarse > 0.1).any()
    np.testing.assert_allclose(coarse, fine, rtol=0.03, atol=0.02 * coarse.max())


def test_a_number_of_steps_at_rest_does_not_matter(robot, grid):
    q = trajectories(robot, steps=1)
    cost = costs.CollisionCost(robot, grid)
    one, _ = cost(q)
    many, _ = cost(np.repeat(q, 37, axis=1))
    assert (one > 0.1).any()
    np.testing.assert_allclose(one, many)


def test_arguments_are_not_changed(robot, grid):
    q = trajectories(robot)
    before = q.copy()
    for cost in path_costs(robot, grid).values():
        cost(q)
    np.testing.assert_array_equal(q, before)


def test_lists_and_single_precision_are_taken(robot, grid):
    q = trajectories(robot).astype(np.float32)
    cost = costs.CollisionCost(robot, grid)
    value, gradient = cost(q)
    assert value.dtype == gradient.dtype == np.float64
    np.testing.assert_array_equal(cost(q.tolist())[0], value)


@pytest.mark.parametrize(
    ("q", "message"),
    [
        (np.zeros((3, 6)), r"trajectories must have shape \(P, T, 6\), got \(3, 6\)"),
        (np.zeros((2, 3, 5)), r"trajectories must have shape \(P, T, 6\), got \(2, 3, 5\)"),
        (np.zeros((2, 0, 6)), "got \\(2, 0, 6\\)"),
        (np.full((2, 3, 6), np.nan), "got nan in particle 0, step 0, joint 0"),
        (np.full((2, 3, 6), np.inf), "trajectories must be finite, got inf"),
    ],
)
def test_bad_trajectories_are_refused(robot, grid, q, message):
    region = GoalRegion(np.zeros(3), np.zeros(3), np.ones(3))
    via = ToolViaPoint(0.5, np.zeros(3), np.zeros(3), 0.1)
    for cost in (
        *path_costs(robot, grid).values(),
        ToolPath((via,), robot).cost(PlanSettings()),
        Reaching((region,), robot).cost(PlanSettings()),
    ):
        with pytest.raises(ValueError, match=message):
            cost(q)


def test_bad_settings_are_refused(robot, grid):
    q = trajectories(robot)
    collision = costs.CollisionCost(robot, grid)
    zeros = np.zeros(3)
    for make, message in (
        (lambda: collision(q, 0.0), "edge_width must be positive, got 0.0"),
        (lambda: collision(q, np.nan), "edge_width must be positive, got nan"),
        (lambda: collision(q, 0.01, np.inf), "margin must be finite, got inf"),
        (lambda: costs.SelfCollisionCost(robot, -1.0), "edge_width must be positive, got -1.0"),
        (lambda: costs.SelfCollisionCost(robot, 0.01, -0.1), "margin must be above -0.06"),
        (lambda: costs.JointLimitCost(zeros, zeros), "leave no room"),
        (lambda: costs.JointLimitCost(zeros, np.ones(2)), r"got \(3,\) and \(2,\)"),
        (lambda: costs.VelocityLimitCost(zeros, 1.0), "velocity must be"),
        (lambda: costs.VelocityLimitCost(np.ones(6), 0.0), "duration must be positive, got 0.0"),
    ):
        with pytest.raises(ValueError, match=message):
            make()
