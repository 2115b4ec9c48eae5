"""Sites against distributions of torch, finite differences, and Bayes' rule."""

import numpy as np
import pytest
import torch
from torch.distributions import Categorical, MixtureSameFamily, MultivariateNormal

from smp_gym.geometry.distance import signed_distance
from smp_planner.library.adapt_settings import AdaptSettings
from smp_planner.library.frame import Frame
from smp_planner.library.modulation import AnyOf, Box, ViaPoint
from smp_planner.library.requests import constraints_of
from smp_planner.library.shapes import Circle, Rectangle, bodies
from smp_planner.movement_primitives import GaussianBasis, ProMP
from smp_planner.movement_primitives.mixture import shared_out
from smp_planner.planning.ball import Ball
from smp_planner.planning.conditioning import condition
from smp_planner.planning.constraints import at_phases
from smp_planner.planning.path_clearance import path_clearance
from smp_planner.planning.problem import Problem, Stage
from smp_planner.planning.target import SceneTarget

FRAME = Frame(np.array([1.0, 2.0]), 4.0)
POINTS = np.random.default_rng(0).uniform(-0.5, 0.5, (40, 2))


def site_of(goal, sigma=0.1):
    (site,) = constraints_of(FRAME, None, (), goal, sigma, None)
    return site


def cost(site, points, sigma=0.1):
    """Return cost and gradient of a constraint at its phase, for points (P, D)."""
    value, gradient = site.cost(AdaptSettings(sigma=sigma))(np.stack([points, points], axis=1))
    return value, gradient.sum(axis=1)


def missed(site, points):
    return site.missed(np.stack([points, points], axis=1))


def difference(function, points, step=1e-6):
    """Return the gradient (P, D) of a function of points (P, D) by central differences."""
    columns = []
    for axis in np.eye(points.shape[1]):
        change = function(points + step * axis) - function(points - step * axis)
        columns.append(change / (2.0 * step))
    return np.stack(columns, axis=1)


@pytest.mark.parametrize(
    "goal",
    [
        (1.5, 2.0),
        Box((0.5, 1.0), (1.5, 2.5), sigma=0.3),
        AnyOf([(0.0, 2.0), (2.0, 2.5)], shares=(0.3, 0.7)),
        AnyOf([Box((0.0, 1.0), (1.0, 2.0)), Box((2.0, 2.0), (2.5, 2.5), sigma=0.9)]),
    ],
)
def test_gradients_of_sites(goal):
    site = site_of(goal)
    np.testing.assert_allclose(
        cost(site, POINTS)[1], difference(lambda p: cost(site, p)[0], POINTS), atol=1e-5, rtol=1e-5
    )


def test_a_choice_of_points_costs_what_the_mixture_says():
    site = site_of(AnyOf([(0.0, 2.0), (2.0, 2.5)], shares=(0.3, 0.7)), sigma=0.2)
    means = torch.from_numpy(FRAME.inwards([(0.0, 2.0), (2.0, 2.5)]))
    mixture = MixtureSameFamily(
        Categorical(torch.tensor([0.3, 0.7])),
        MultivariateNormal(means, torch.eye(2).double().expand(2, 2, 2) * 0.04),
    )
    expected = -mixture.log_prob(torch.from_numpy(POINTS)).numpy()
    constant = np.log(2.0 * np.pi * 0.04)
    np.testing.assert_allclose(cost(site, POINTS)[0], expected - constant, atol=1e-6)


def test_a_box_costs_nothing_inside_and_as_eq_14_says_outside():
    box = Box((0.0, 1.0), (2.0, 3.0), sigma=0.8)
    inside, outside = FRAME.inwards([[1.0, 1.5], [3.0, 1.5]])
    site, printed = site_of(box), site_of(Box((0.0, 1.0), (2.0, 3.0), 0.8, paper_scale=True))
    assert cost(site, inside[None])[0] == 0.0
    assert cost(site, outside[None])[0] == pytest.approx(1.0 / (2.0 * 0.8**2))
    assert cost(printed, outside[None])[0] == pytest.approx(1.0 / (np.sqrt(2.0) * 0.8**2))
    assert FRAME.scale * missed(site, outside[None]) == pytest.approx(1.0)


def test_what_is_within_a_tolerance_is_not_missed():
    (site,) = constraints_of(FRAME, None, [ViaPoint(0.3, (1.0, 2.0), 0.4)], None, 0.1, None)
    points = FRAME.inwards([[1.0, 2.39], [1.0, 2.5]])
    np.testing.assert_allclose(FRAME.scale * missed(site, points), [0.0, 0.1], atol=1e-8)
    # The box within which nothing is paid lies in the ball of the tolerance.
    corner = site.places[0].box.upper.numpy()
    assert np.linalg.norm(corner - site.places[0].point) < 0.4 / FRAME.scale


@pytest.fixture(scope="module")
def primitive():
    rng = np.random.default_rng(3)
    half = torch.from_numpy(rng.normal(size=(12, 12)))
    mean = torch.from_numpy(rng.normal(size=12))
    return ProMP.from_covariance(
        GaussianBasis(6), mean, 0.02 * half @ half.mT, 0.01 * torch.eye(2).double()
    )


def test_branches_are_the_posterior_of_a_mixture(primitive):
    noise = 0.3 / 3.0 / FRAME.scale
    options = [ViaPoint(0.4, (1.0, 2.0), 0.3), ViaPoint(0.4, (2.0, 3.0), 0.3)]
    sites = constraints_of(FRAME, None, [AnyOf(options, (0.6, 0.4))], None, 0.01, None)
    found = condition(primitive, sites, AdaptSettings(particles=10_000))
    # Bayes' rule by importance weights of draws from the prior.
    weights = primitive.sample(200_000, torch.Generator().manual_seed(0))
    at = primitive.trajectory(weights, torch.tensor([0.4]).double())[:, 0]
    places = torch.from_numpy(FRAME.inwards([(1.0, 2.0), (2.0, 3.0)]))
    likelihood = torch.exp(-0.5 * (at[:, None] - places).square().sum(-1) / noise**2)
    evidence = likelihood.mean(0) * torch.tensor([0.6, 0.4])
    share = (evidence / evidence.sum()).numpy()
    counts = np.array(shared_out(10_000, [weight for _, weight in found]))
    assert counts.sum() == 10_000
    np.testing.assert_allclose(counts / 10_000, share, atol=0.03)
    expected = (likelihood[:, 0] @ weights) / likelihood[:, 0].sum()
    spread = primitive.covariance.diagonal().sqrt()
    assert ((found[0][0].mean - expected).abs() / spread).max() < 0.1


def test_branches_without_a_share_are_left_out(primitive):
    far = AnyOf([FRAME.outwards(primitive.marginal(1.0)[0].numpy()), (400.0, 400.0)])
    sites = constraints_of(FRAME, None, (), far, 0.01, None)
    assert len(condition(primitive, sites, AdaptSettings(particles=42))) == 1


def target_of(obstacles, constraints, radius=0.02):
    ball = Ball(2, radius)
    problem = Problem(ball, constraints, (Stage(0.0, 1.0, ball, obstacles),))
    return SceneTarget(problem, AdaptSettings())


def curve(steps):
    phase = np.linspace(0.0, 1.0, steps)
    return np.stack([phase - 0.5, 0.3 * np.sin(3.0 * phase)], axis=1)[None]


@pytest.mark.parametrize("steps", [50, 100])
def test_costs_of_a_path_do_not_change_with_its_number_of_steps(steps):
    obstacles = bodies([Circle((1.0, 3.0), 0.5), Rectangle((2.0, 2.5), (0.3, 0.6), 0.4)], FRAME)
    via = [ViaPoint(0.37, (1.0, 2.1), 0.2)]
    sites = constraints_of(FRAME, (-1.0, 2.1), via, (3.0, 2.0), 0.05, None)
    target = target_of(obstacles, sites)
    fine, coarse = (target.costs(curve(n)) for n in (2 * steps, steps))
    assert fine["obstacles"] > 1.0
    for name, value in fine.items():
        np.testing.assert_allclose(coarse[name], value, rtol=0.01)


def test_the_gradient_of_a_scene_is_that_of_its_weighted_sum():
    obstacles = bodies([Circle((1.0, 3.0), 0.5)], FRAME)
    sites = constraints_of(FRAME, None, [ViaPoint(0.37, (1.0, 2.1), 0.2)], (3.0, 2.0), 0.05, None)
    target = target_of(obstacles, sites)
    path = curve(50)
    gradient = target.gradient(path, 1.0)
    for step in (0, 13, 18, 19, 30, 49):
        for axis in range(2):
            change = np.zeros(path.shape)
            change[0, step, axis] = 1e-6
            expected = target.weighted_sum(path + change) - target.weighted_sum(path - change)
            assert gradient[0, step, axis] == pytest.approx(expected[0] / 2e-6, abs=1e-4)


def test_places_between_steps_are_interpolated():
    line = np.linspace([0.0, 1.0], [3.0, -1.0], 7)[None]
    for phase in (0.0, 0.31, 0.999, 1.0):
        np.testing.assert_allclose(at_phases(line, phase)[0, 0], [3.0 * phase, 1.0 - 2.0 * phase])
    sites = constraints_of(FRAME, None, [ViaPoint(0.25, (0.0, 0.0))], (1.0, 1.0), 0.1, None)
    np.testing.assert_allclose(target_of((), sites).pins, [0, 0.25, 1])


def test_clearance_between_samples_is_found():
    obstacles = bodies([Circle((1.0, 2.0), 0.01), Rectangle((3.0, 2.0), (0.5, 0.2), 0.3)], FRAME)
    rng = np.random.default_rng(5)
    paths = np.zeros((30, 6, 3))
    paths[..., :2] = rng.uniform(-0.7, 0.7, (30, 6, 2))
    share = np.linspace(0.0, 1.0, 4001)[:, None, None, None]
    dense = paths[:, :-1] + share * np.diff(paths, axis=1)
    expected = signed_distance(dense, obstacles).min(axis=(0, 2))
    found = path_clearance(paths, obstacles, 1e-4)
    assert (found <= expected + 1e-4).all()
    assert (found >= expected - 4e-4).all()
    assert np.isinf(path_clearance(paths, ())).all()
