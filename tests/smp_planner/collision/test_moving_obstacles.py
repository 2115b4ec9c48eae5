"""Obstacles that move: expected places, the cost's gradient, and the check in time."""

import numpy as np
import pytest
import torch

from smp_gym.geometry.distance import signed_distance
from smp_gym.robot.kinematics import JOINT_LOWER, JOINT_UPPER, box_spheres
from smp_gym.scene import Motion, Obstacle
from smp_planner.collision.clearance_in_time import clearance_in_time
from smp_planner.collision.costs import CUTOFF_WIDTHS, steps_scale
from smp_planner.collision.forecast import Forecast, is_moving
from smp_planner.collision.moving_cost import MovingCollisionCost
from smp_planner.collision.robot_model import jaco_model

HELD = np.eye(4)
ROBOT = jaco_model(box_spheres(np.array([0.02, 0.02, 0.03]), HELD))
BODIES = (
    Obstacle(shape="sphere", position=(0.4, 0.1, 0.4), size=(0.08,) * 3, velocity=(0.1, 0.05, 0.0)),
    Obstacle(
        shape="box",
        position=(0.3, -0.2, 0.5),
        quaternion=(0.0, 0.0, np.sin(0.4), np.cos(0.4)),
        size=(0.05, 0.1, 0.15),
        velocity=(0.0, 0.1, -0.05),
    ),
)
FORECAST = Forecast(BODIES, np.array([[0.0, 0.0, 0.6], [0.0, 0.0, 0.0]]), 2.0, 0.2, 0.03)


def _paths(count: int, steps: int) -> np.ndarray:
    """Return smooth trajectories near the bodies, (P, T, 6) rad."""
    rng = np.random.default_rng(4)
    middle = np.clip(np.array([0.3, 2.2, 1.6, 0.4, 1.2, 0.5]), JOINT_LOWER, JOINT_UPPER)
    ends = middle + 0.5 * rng.standard_normal((count, 2, 6))
    share = np.linspace(0.0, 1.0, steps)[:, None]
    return (1.0 - share) * ends[:, :1] + share * ends[:, 1:]


def test_the_expected_place_follows_a_turning_motion_until_the_horizon():
    """On a circle, exact knowledge of velocity and turn predicts `Motion` within millimetres."""
    radius, speed = 0.15, 0.1
    rate = speed / radius
    knots = np.arange(0.0, 4.1, 0.25)
    points = np.stack(
        [radius * np.cos(rate * knots), radius * np.sin(rate * knots), 0.0 * knots], 1
    )
    motion = Motion(times=tuple(knots.tolist()), points=tuple(map(tuple, points.tolist())))
    here, velocity = motion.at(1.0)
    body = Obstacle(
        shape="sphere", position=tuple(here), size=(0.05,) * 3, velocity=tuple(velocity)
    )
    forecast = Forecast((body,), np.array([[0.0, 0.0, rate]]), 2.0, 0.0, 0.0)
    for time in (0.0, 0.4, 1.0, 2.0):
        expected = motion.at(1.0 + time)[0]
        assert np.linalg.norm(forecast.positions(time)[0] - expected) < 2e-3
    straight = Forecast((body,), np.zeros((1, 3)), 2.0, 0.0, 0.0)
    np.testing.assert_allclose(straight.positions(0.7)[0], body.at(0.7)[0])
    np.testing.assert_array_equal(straight.positions(2.0), straight.positions(9.0))


def test_margins_grow_with_the_distance_gone_up_to_the_cap_and_standing_bodies_have_none():
    standing = BODIES[0].model_copy(update={"velocity": (0.0, 0.0, 0.0)})
    assert is_moving(BODIES[0])
    assert not is_moving(standing)
    forecast = Forecast((BODIES[0], standing), np.zeros((2, 3)), 2.0, 0.2, 0.03, 0.01)
    speed = np.hypot(0.1, 0.05)
    margins = forecast.margins(np.array([0.0, 0.5, 1.9, 5.0]))
    np.testing.assert_allclose(margins[:, 0], [0.01, 0.01 + 0.1 * speed, 0.03, 0.03])
    assert not margins[:, 1].any()


def test_the_gradient_of_the_cost_is_that_of_float64_autograd():
    """Value and gradient agree with spheres and boxes written down in torch."""
    paths = _paths(3, 12)
    times = np.linspace(0.0, 3.0, 12) * np.array([[1.0], [0.5], [2.0]])
    width, margin = 0.03, 0.01
    value, gradient = MovingCollisionCost(ROBOT, FORECAST)(paths, times, width, margin)

    q = torch.tensor(paths, requires_grad=True)
    centers = ROBOT.sphere_centers(q)[:, :, ROBOT.link > 0]
    radius = torch.tensor(ROBOT.radius[ROBOT.link > 0])
    positions = torch.tensor(FORECAST.positions(times))[:, :, None]
    margins = torch.tensor(FORECAST.margins(times))[:, :, None]
    apart = centers - positions[..., 0, :]
    round_ = apart.norm(dim=-1) - 0.08 - margins[..., 0]
    turn = torch.tensor([[np.cos(0.8), np.sin(0.8), 0], [-np.sin(0.8), np.cos(0.8), 0], [0, 0, 1]])
    outside = ((centers - positions[..., 1, :]) @ turn.T).abs() - torch.tensor(BODIES[1].size)
    length = (outside.clamp(min=0.0).square().sum(-1) + 1e-300).sqrt()
    square = length + outside.max(-1).values.clamp(max=0.0) - margins[..., 1]
    distance = torch.minimum(round_, square)
    far = radius + margin + CUTOFF_WIDTHS * width
    floor = torch.sigmoid(torch.tensor(-CUTOFF_WIDTHS, dtype=torch.float64)) ** 2
    occupancy = torch.sigmoid((radius + margin - distance) / width)
    terms = torch.where(distance < far, occupancy.square() - floor, 0.0)
    expected = steps_scale(12) * terms.sum((1, 2))
    expected.sum().backward()
    assert (value > 0.01).all()
    np.testing.assert_allclose(value, expected.detach(), rtol=1e-6)
    np.testing.assert_allclose(gradient, q.grad, rtol=1e-4, atol=1e-6)


def test_the_check_in_time_finds_the_least_distance_of_a_dense_one():
    paths = _paths(12, 15)
    times = np.tile(np.linspace(0.0, 2.0, 15), (12, 1))
    found = clearance_in_time(paths, times, ROBOT, FORECAST, enough=1.0)
    dense, at = np.linspace(0.0, 14.0, 14 * 40 + 1), np.arange(15.0)
    for path, clearance in zip(paths, found, strict=True):
        between = np.stack([np.interp(dense, at, column) for column in path.T], axis=1)
        centers = ROBOT.sphere_centers(torch.tensor(between)).numpy()[:, ROBOT.link > 0]
        radius = ROBOT.radius[ROBOT.link > 0]
        least = np.inf
        positions, margins = FORECAST.positions(times[0]), FORECAST.margins(times[0])
        for k, instant in enumerate(dense):
            for n, body in enumerate(BODIES):
                where = [np.interp(instant, at, positions[:, n, axis]) for axis in range(3)]
                moved = body.model_copy(update={"position": tuple(map(float, where))})
                gap = signed_distance(centers[k], (moved,)) - radius
                least = min(least, gap.min() - np.interp(instant, at, margins[:, n]))
        assert clearance == pytest.approx(least, abs=2e-3)


def test_a_body_that_is_there_at_another_time_is_no_collision():
    body = Obstacle(shape="sphere", position=(0.4, 0.0, 0.4), size=(0.1,) * 3, velocity=(0, 0.5, 0))
    forecast = Forecast((body,), np.zeros((1, 3)), 10.0, 0.0, 0.0)
    q = np.tile([np.pi, np.pi / 2 + 0.6, np.pi / 2, 0.0, np.pi, 0.0], (1, 2, 1))
    reach = ROBOT.sphere_centers(torch.tensor(q[0, 0])).numpy()[-1]
    there = body.model_copy(update={"position": tuple(map(float, reach))})
    hit = Forecast((there,), np.zeros((1, 3)), 10.0, 0.0, 0.0)
    assert clearance_in_time(q, np.array([[0.0, 0.1]]), ROBOT, hit)[0] < 0.0
    assert clearance_in_time(q, np.array([[6.0, 6.1]]), ROBOT, hit)[0] > 0.05
    assert clearance_in_time(q, np.array([[0.0, 0.1]]), ROBOT, forecast, enough=0.1)[0] > -1.0
    empty = Forecast((), np.empty((0, 3)), 1.0, 0.0, 0.0)
    assert clearance_in_time(q, np.zeros((1, 2)), ROBOT, empty)[0] == np.inf


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"turn": np.zeros((1, 3))}, "turn must be"),
        ({"horizon": -1.0}, "horizon must be finite and not negative, got -1.0"),
        ({"growth": np.nan}, "growth must be finite and not negative, got nan"),
        ({"most": np.inf}, "most must be finite and not negative, got inf"),
    ],
)
def test_forecasts_refuse_bad_numbers(change, message):
    arguments = {"turn": np.zeros((2, 3)), "horizon": 1.0, "growth": 0.1, "most": 0.1, **change}
    with pytest.raises(ValueError, match=message):
        Forecast(BODIES, **arguments)


def test_the_cost_refuses_times_of_another_shape():
    with pytest.raises(ValueError, match=r"times must be \(2, 5\) finite numbers"):
        MovingCollisionCost(ROBOT, FORECAST)(_paths(2, 5), np.zeros(5))
