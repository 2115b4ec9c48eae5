"""The Gaussian under chance constraints, against closed forms and another solver's solution."""

from statistics import NormalDist

import numpy as np
import pytest
import torch
from scipy.optimize import brentq, minimize

from smp_planner.adaptation import ChanceSettings, Runs, StepConstraint, adaptation
from smp_planner.adaptation.chance_constrained import Lagrangian, constrained_gaussian

STEPS = 30
FINE = ChanceSettings(risk=0.05, rounds=40, iterations=100, growth=1e4)


class HalfPlane:
    """Distance from a line, positive on one side of it."""

    def __init__(self, normal):
        self.normal = np.array(normal) / np.linalg.norm(normal)

    def __call__(self, configurations):
        return (configurations @ self.normal)[:, None]

    def pull_back(self, configurations, slopes):
        return slopes * self.normal


class Planes:
    """A scene of half-planes, each at one step, and of nothing else."""

    steps = STEPS
    pins = np.array([0.0, 1.0])

    def __init__(self, *planes, width=0.1):
        self.scenes, self.planes, self.width = (self,), planes, width

    def step_constraints(self):
        return [
            StepConstraint(slice(step, step + 1), HalfPlane(normal), margin, self.width, 1.0)
            for step, normal, margin in self.planes
        ]

    def evaluate_others(self, trajectories, progress):
        return np.zeros(len(trajectories)), np.zeros(trajectories.shape)


class Waves(Planes):
    """Half-planes, and a cost that is no quadratic."""

    def evaluate_others(self, trajectories, progress):
        return np.sin(trajectories).sum(axis=(1, 2)), np.cos(trajectories)


def rows_of(prior, scene):
    """Return the rows (C, r) by which clearances depend on the whitened coordinates."""
    columns = prior.trajectory(prior.factor.mT.contiguous(), STEPS)
    return torch.stack(
        [
            columns[:, c.steps.start] @ torch.from_numpy(c.clearances.normal)
            for c in scene.step_constraints()
        ]
    ).numpy()


def solved(prior, scene, settings=FINE):
    found = constrained_gaussian(prior, scene, np.random.default_rng(0), settings)
    return found.mean.numpy(), (found.factor @ found.factor.mT).numpy(), found


@pytest.mark.parametrize("risk", [0.2, 0.05, 0.01])
def test_one_half_plane_has_a_closed_form(prior, risk):
    """Along the row a, |a| = s, with f the deviation and k s the multiplier there:

    m = k, f - 1 / f = -k z, and s (k - z f) = margin.
    """
    scene = Planes((15, (0.3, 1.0), 0.4))
    (row,) = rows_of(prior, scene)
    scale, z = np.linalg.norm(row), NormalDist().inv_cdf(1.0 - risk)

    def std(k):
        return (np.sqrt((k * z) ** 2 + 4.0) - k * z) / 2.0

    k = brentq(lambda k: scale * (k - z * std(k)) - 0.4, 0.0, 100.0)
    mean, covariance, found = solved(prior, scene, FINE.model_copy(update={"risk": risk}))
    unit = row / scale
    np.testing.assert_allclose(mean, k * unit, atol=2e-3)
    expected = np.eye(len(row)) + (std(k) ** 2 - 1.0) * np.outer(unit, unit)
    np.testing.assert_allclose(covariance, expected, atol=2e-3)
    assert found.multipliers[0].item() == pytest.approx(k / scale, rel=0.02)
    drawn = np.random.default_rng(1).multivariate_normal(mean, covariance, 200_000)
    assert (drawn @ row < 0.4).mean() == pytest.approx(risk, rel=0.06)


def test_several_half_planes_agree_with_slsqp(prior):
    """The solution differs from the prior in the span of the rows only: so small is the problem."""
    scene = Planes((10, (0.0, 1.0), 0.3), (20, (1.0, 0.2), 0.5), (25, (0.0, 1.0), -5.0))
    rows = rows_of(prior, scene)
    z = NormalDist().inv_cdf(0.95)
    basis = np.linalg.qr(rows.T)[0]
    small, margins = rows @ basis, np.array([0.3, 0.5, -5.0])
    lower = np.tril_indices(3)

    def parts(x):
        root = np.zeros((3, 3))
        root[lower] = x[3:]
        return x[:3], root

    def divergence(x):
        mean, root = parts(x)
        logarithm = np.log(np.abs(np.diag(root))).sum()
        return 0.5 * (mean @ mean + np.square(root).sum() - 3.0) - logarithm

    def kept(x):
        mean, root = parts(x)
        return small @ mean - z * np.linalg.norm(small @ root, axis=1) - margins

    begin = np.concatenate([np.full(3, 0.1), np.eye(3)[lower]])
    best = minimize(
        divergence,
        begin,
        method="SLSQP",
        constraints={"type": "ineq", "fun": kept},
        options={"maxiter": 500, "ftol": 1e-12},
    )
    assert best.success
    expected_mean, root = parts(best.x)
    mean, covariance, found = solved(prior, scene)
    np.testing.assert_allclose(mean, basis @ expected_mean, atol=5e-3)
    change = basis @ (root @ root.T - np.eye(3)) @ basis.T
    np.testing.assert_allclose(covariance, np.eye(len(mean)) + change, atol=5e-3)
    multipliers = [float(m) for m in found.multipliers]
    assert min(multipliers[:2]) > 0.1
    assert multipliers[2] < 1e-6


@pytest.mark.parametrize("scene", [Planes, Waves])
def test_the_gradient_by_finite_differences(prior, scene):
    noise = torch.randn(4, prior.rank, dtype=torch.float64)
    lagrangian = Lagrangian(prior, scene((10, (0.2, 1.0), 0.3), (20, (1.0, 0.0), 0.1)), noise, 1.3)
    rng = np.random.default_rng(2)
    parameters = lagrangian.prior() + 0.1 * rng.normal(size=lagrangian.prior().shape)
    gradient = lagrangian(parameters)[1]
    for direction in rng.normal(size=(6, len(parameters))):
        ahead, behind = (lagrangian(parameters + s * 1e-5 * direction)[0] for s in (1.0, -1.0))
        assert gradient @ direction == pytest.approx((ahead - behind) / 2e-5, rel=1e-5, abs=1e-6)


def test_the_divergence_is_torch_s(prior):
    lagrangian = Lagrangian(prior, Planes(), torch.zeros(2, prior.rank, dtype=torch.float64), 1.0)
    parameters = 0.3 * np.random.default_rng(3).normal(size=lagrangian.prior().shape)
    mean, factor = lagrangian.gaussian(torch.from_numpy(parameters))
    rank = prior.rank
    own = torch.distributions.MultivariateNormal(mean, scale_tril=factor)
    standard = torch.distributions.MultivariateNormal(
        torch.zeros(rank, dtype=torch.float64), torch.eye(rank, dtype=torch.float64)
    )
    expected = torch.distributions.kl_divergence(own, standard)
    assert lagrangian(parameters)[0] == pytest.approx(float(expected))


def test_what_cannot_be_kept_is_left_as_it_is(prior):
    """The path is held at its start, so a constraint there changes nothing."""
    mean, covariance, found = solved(prior, Planes((0, (0.0, 1.0), 0.5)))
    np.testing.assert_allclose(mean, 0.0, atol=1e-9)
    np.testing.assert_allclose(covariance, np.eye(len(mean)), atol=1e-9)
    assert found.multipliers == ()


def test_growth_bounds_what_a_constraint_asks_for(prior):
    scene = Planes((15, (0.0, 1.0), 3.0))
    mean = solved(prior, scene, ChanceSettings(growth=1.0, decay=1.0))[0]
    wide = solved(prior, scene)[0]
    (row,) = rows_of(prior, scene)
    assert 0.0 < row @ mean < row @ wide


def test_draws_are_carried_to_the_gaussian(prior):
    method = adaptation("cpromp_chance", rounds=3)
    latent = torch.randn(2, 50, prior.rank, dtype=torch.float64)
    scene = Planes((15, (0.0, 1.0), 0.3))

    class Both:
        steps, scenes = STEPS, (scene, Planes())

    found = method.adapt(
        Runs.of([prior, prior], STEPS),
        latent,
        Both(),
        [np.random.default_rng(0), np.random.default_rng(1)],
        method.settings,
        None,
    )
    mean, _, of_one = solved(prior, scene, method.settings)
    torch.testing.assert_close(found[0], torch.from_numpy(mean) + latent[0] @ of_one.factor.mT)
    torch.testing.assert_close(found[1], latent[1])
