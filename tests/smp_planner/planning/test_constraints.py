"""Constraints: costs against torch's distributions and finite differences, and what is refused."""

import numpy as np
import pytest
import torch

from smp_gym.robot import kinematics
from smp_planner.collision.robot_model import jaco_model
from smp_planner.library.frame import Frame
from smp_planner.library.modulation import ViaPoint
from smp_planner.library.requests import constraints_of
from smp_planner.planning.constraints import Exactly, at_phases, spread_to_steps
from smp_planner.planning.settings import PlanSettings
from smp_planner.planning.tool_constraints import Reaching, ToolPath
from smp_planner.planning.tool_goals import GoalRegion, ToolViaPoint

POINT = np.array([0.02, 0.01, -0.03])


@pytest.fixture(scope="module")
def robot():
    return jaco_model(kinematics.finger_spheres(np.array([0.3, 0.4, 0.2, 0.1])))


def trajectories(robot, particles=6, steps=12, seed=3):
    rng = np.random.default_rng(seed)
    ends = rng.uniform(robot.lower, robot.upper, (2, particles, 1, robot.joints))
    phase = np.linspace(0.0, 1.0, steps)[None, :, None]
    return ends[0] + 0.4 * (ends[1] - ends[0]) * phase**2


def assert_gradient(cost, q, rtol=1e-5, step=1e-6):
    """Against central differences along 8 random directions."""
    directions = np.random.default_rng(4).normal(size=(8, *q.shape))
    expected = np.stack(
        [(cost(q + step * d)[0] - cost(q - step * d)[0]) / (2 * step) for d in directions]
    )
    value, gradient = cost(q)
    assert value.shape == (len(q),)
    assert gradient.shape == q.shape
    assert np.abs(expected).max() > 0.0
    found = (directions * gradient).sum(axis=(2, 3))
    np.testing.assert_allclose(found, expected, rtol=0, atol=rtol * np.abs(expected).max())


def carried(q, step, point=POINT):
    pose = kinematics.end_effector_pose(q[:, step])
    return pose[..., :3, :3] @ point + pose[..., :3, 3]


def tool_path(robot, phases, lower, upper):
    """A path of boxes: `via_share` of the tolerance to each side of the middle."""
    lower, upper = np.asarray(lower), np.asarray(upper)
    half = (upper - lower).max() / 2
    via = [ToolViaPoint(p, POINT, (lower + upper) / 2, max(half, 1e-12)) for p in phases]
    return ToolPath(tuple(via), robot).cost(PlanSettings(sigma=0.05, via_share=1.0))


def test_a_point_in_coordinates_costs_what_its_gaussian_says():
    q = np.random.default_rng(0).normal(size=(4, 9, 3))
    frame, targets = Frame(np.zeros(3), 1.0), np.array([[0.1, -0.2, 0.3], [0.5, 0.2, 1.0]])
    via = [ViaPoint(0.25, targets[0]), ViaPoint(1.0, targets[1])]
    constraints = constraints_of(frame, None, via, None, 0.2, None)
    cost = [constraint.cost(PlanSettings(sigma=0.2)) for constraint in constraints]
    density = torch.distributions.Normal(torch.as_tensor(frame.inwards(targets)), 0.2)
    peak = density.log_prob(density.mean).sum()
    expected = peak - density.log_prob(torch.as_tensor(q[:, [2, 8]])).sum(dim=(1, 2))
    np.testing.assert_allclose(cost[0](q)[0] + cost[1](q)[0], expected.numpy(), rtol=1e-6)
    for one in cost:
        assert_gradient(one, q)


@pytest.mark.parametrize("traced", [1, 0, -3, 2.5, True, "32"])
def test_the_points_of_a_recorded_path_are_a_whole_number(robot, traced):
    via = ToolViaPoint(0.5, POINT, np.zeros(3), 0.1)
    with pytest.raises(ValueError, match=r"traced must be .* got"):
        ToolPath((via,), robot, traced=traced)


def test_via_points_of_the_tool(robot):
    q, place = trajectories(robot), np.array([0.3, 0.2, 0.1])
    cost = tool_path(robot, (4 / 11, 1.0), place, place)
    assert_gradient(cost, q)
    error = np.stack([carried(q, 4), carried(q, 11)], axis=1) - place
    expected = np.square(error).sum(axis=(1, 2)) / (2 * 0.05**2)
    np.testing.assert_allclose(cost(q)[0], expected, rtol=1e-9)


def test_boxes_of_the_tool(robot):
    q, middle, half = trajectories(robot), np.array([0.0, -0.05, 0.35]), 0.15
    cost = tool_path(robot, (0.0, 7 / 11), middle - half, middle + half)
    points = np.stack([carried(q, 0), carried(q, 7)], axis=1)
    beyond = np.maximum(np.abs(points - middle) - half, 0.0)
    expected = np.square(beyond / 0.05).sum(axis=(1, 2)) / 2
    np.testing.assert_allclose(cost(q)[0], expected, atol=1e-9)
    assert_gradient(cost, q)
    here = carried(q, 7)[2]
    value, gradient = tool_path(robot, (7 / 11,), here - 0.01, here + 0.01)(q)
    assert value[2] == 0.0
    assert (gradient[2] == 0.0).all()


def test_a_choice_of_goals_is_a_mixture(robot):
    q = trajectories(robot)
    points = np.array([[0.02, 0.01, -0.03], [0.05, 0.0, 0.0]])
    means = np.array([[0.3, 0.2, 0.1], [0.2, -0.4, 0.3]])
    shares, sigma = np.array([1.0, 3.0]), 0.3
    goals = tuple(GoalRegion(p, m, m) for p, m in zip(points, means, strict=True))
    cost = Reaching(goals, robot, tuple(shares)).cost(PlanSettings(sigma=sigma))
    ends = np.stack([carried(q, -1, point) for point in points], axis=1)
    mixture = torch.distributions.Categorical(torch.as_tensor(shares))
    normal = torch.distributions.Normal(torch.as_tensor(means), sigma)
    log_density = torch.logsumexp(
        mixture.logits + normal.log_prob(torch.as_tensor(ends)).sum(dim=2), dim=1
    )
    constant = 3 * torch.distributions.Normal(0.0, sigma).log_prob(torch.tensor(0.0))
    np.testing.assert_allclose(cost(q)[0], (constant - log_density).numpy(), rtol=1e-6)
    assert_gradient(cost, q)


def test_one_goal_is_a_smooth_box(robot):
    q = trajectories(robot)
    region = GoalRegion(POINT, (0.1, -0.1, 0.0), (0.3, 0.1, 0.2))
    value, gradient = Reaching((region,), robot).cost(PlanSettings(sigma=0.05))(q)
    expected_value, expected_gradient = tool_path(robot, (1.0,), region.lower, region.upper)(q)
    assert (expected_value > 0.0).any()
    np.testing.assert_allclose(value, expected_value)
    np.testing.assert_allclose(gradient, expected_gradient, atol=1e-9)


def test_far_from_every_goal_the_gradient_is_finite(robot):
    goals = tuple(GoalRegion(np.zeros(3), (x, 0, 0), (x, 0, 0)) for x in (50.0, 60.0))
    value, gradient = Reaching(goals, robot).cost(PlanSettings(sigma=1e-3))(trajectories(robot))
    assert np.isfinite(value).all()
    assert np.isfinite(gradient).all()


@pytest.mark.parametrize("steps", [5, 50])
def test_gradients_at_phases_go_back_to_the_samples_they_came_from(steps):
    """The transpose of the interpolation: <at_phases(q), g> = <q, spread_to_steps(g)>."""
    rng, phases = np.random.default_rng(1), (0.0, 0.31, 0.5, 0.999, 1.0)
    q, g = rng.normal(size=(3, steps, 2)), rng.normal(size=(3, len(phases), 2))
    left = (at_phases(q, phases) * g).sum()
    assert left == pytest.approx((q * spread_to_steps(g, phases, steps)).sum())


def test_an_exact_start_is_missed_by_its_distance():
    start = Exactly("start", 0.0, np.array([1.0, 2.0]))
    paths = np.array([[[1.0, 2.0], [0.0, 0.0]], [[1.0, 2.5], [0.0, 0.0]]])
    np.testing.assert_allclose(start.missed(paths), [0.0, 0.5])


def test_bad_constraints_are_refused(robot):
    region = GoalRegion(np.zeros(3), np.zeros(3), np.ones(3))
    for make, message in (
        (lambda: Reaching((), robot), "at least one GoalRegion"),
        (lambda: Reaching((region,), robot, (-1.0,)), "shares must be 1 positive"),
        (lambda: Reaching((region,), robot, (1.0, 1.0)), "shares must be 1 positive"),
        (lambda: GoalRegion(np.zeros(2), np.zeros(3), np.ones(3)), "point must have shape"),
        (lambda: GoalRegion(np.zeros(3), np.ones(3), np.zeros(3)), "must not exceed upper"),
        (lambda: GoalRegion(np.full(3, np.nan), np.zeros(3), np.ones(3)), "must be finite"),
        (lambda: ToolViaPoint(1.2, np.zeros(3), np.zeros(3), 0.1), "at most 1.0, got 1.2"),
        (lambda: ToolViaPoint(0.5, np.zeros(3), np.zeros(3), 0.0), "tolerance .* above 0.0"),
    ):
        with pytest.raises(ValueError, match=message):
            make()
