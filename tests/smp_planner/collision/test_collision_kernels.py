"""Kernels and bandwidths against autograd, finite differences, brute force and numpy."""

import math

import numpy as np
import pytest
import torch

from smp_planner.inference.stein_kernels import (
    RBF,
    InverseMultiquadric,
    MetricKernel,
    median_bandwidth,
    median_over_log_bandwidth,
)
from smp_planner.movement_primitives import GaussianBasis, ProMP, smooth_covariance


def _particles(*shape: int, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, generator=generator, dtype=torch.float64)


def _squared(particles: torch.Tensor) -> torch.Tensor:
    return (particles[..., :, None, :] - particles[..., None, :, :]).square().sum(-1)


PROFILES = {
    RBF: lambda squared, bandwidth: torch.exp(-squared / bandwidth),
    InverseMultiquadric: lambda squared, bandwidth: 1 / torch.sqrt(1 + squared / bandwidth),
}
"""k as a function of the squared distance and the bandwidth."""

RULES = [median_bandwidth, median_over_log_bandwidth, 2.5]


def _metric(dimension: int) -> torch.Tensor:
    """Return a root (m, d) of less than full rank."""
    return _particles(max(1, dimension - 2), dimension, seed=7) / math.sqrt(dimension)


@pytest.mark.parametrize("metric", [False, True])
@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("family", PROFILES)
@pytest.mark.parametrize(("count", "dimension"), [(42, 90), (7, 2), (2, 3), (1, 4)])
def test_gram_and_repulsion_agree_with_autograd_and_differences(
    family, rule, metric, count, dimension
):
    particles = _particles(count, dimension)
    root = _metric(dimension) if metric else torch.eye(dimension, dtype=torch.float64)
    kernel = MetricKernel(root, family(rule)) if metric else family(rule)
    gram, repulsion = kernel(particles)
    bandwidth = rule(_squared(particles @ root.mT)) if callable(rule) else rule

    def row(summed, i):
        squared = ((summed - particles[i]) @ root.mT).square().sum(-1)
        return PROFILES[family](squared, bandwidth)

    for i in range(min(count, 4)):
        summed = particles.clone().requires_grad_()
        values = row(summed, i)
        torch.testing.assert_close(gram[i], values.detach(), atol=1e-13, rtol=1e-12)
        (gradient,) = torch.autograd.grad(values.sum(), summed)
        torch.testing.assert_close(repulsion[i], gradient.sum(0), atol=1e-12, rtol=1e-10)
        # All particles that are summed over move together: the sum of their gradients.
        step = 1e-5 * _particles(dimension, seed=i)
        difference = (row(particles + step, i) - row(particles - step, i)).sum() / 2
        torch.testing.assert_close(repulsion[i] @ step, difference, atol=1e-12, rtol=1e-6)


@pytest.mark.parametrize("family", PROFILES)
def test_kernels_are_positive_definite(family):
    for kernel in (family(), MetricKernel(_metric(5), family())):
        gram, _ = kernel(_particles(30, 5))
        torch.testing.assert_close(gram, gram.mT)
        assert float(torch.linalg.eigvalsh(gram)[0]) > -1e-12
        torch.testing.assert_close(gram.diagonal(), torch.ones(30, dtype=torch.float64))


def test_in_the_metric_of_paths_it_is_the_distance_of_trajectories_in_weights_and_whitened():
    basis, steps = GaussianBasis(9), 40
    prior = ProMP.from_covariance(
        basis,
        _particles(18, seed=3),
        smooth_covariance(basis, 2, 0.3, 0.2),
        torch.ones(2, dtype=torch.float64),
    ).condition(0.0, torch.zeros(2, dtype=torch.float64))
    weights = prior.sample(12, torch.Generator().manual_seed(0))
    paths = prior.trajectory(weights, steps)
    squared = (paths[:, None] - paths).square().sum(-1).mean(-1)
    root = prior.path_root(steps)
    for family, profile in PROFILES.items():
        raw = MetricKernel(root, family())(weights)
        torch.testing.assert_close(raw.gram, profile(squared, median_bandwidth(squared)))
        latent = MetricKernel(prior.whiten_gradient(root), family())(prior.whiten(weights))
        torch.testing.assert_close(latent.gram, raw.gram)
        torch.testing.assert_close(latent.repulsion, prior.whiten_gradient(raw.repulsion))


@pytest.mark.parametrize("family", PROFILES)
def test_a_set_far_from_the_origin_loses_no_digits(family):
    particles = _particles(20, 5)
    near, far = family(3.0)(particles), family(3.0)(particles + 1e5)
    torch.testing.assert_close(far.gram, near.gram, atol=1e-9, rtol=0)
    torch.testing.assert_close(far.repulsion, near.repulsion, atol=1e-8, rtol=0)


@pytest.mark.parametrize("count", [2, 3, 4, 5, 7, 42])
def test_median_bandwidth_is_the_squared_lower_median_of_the_pairs(count):
    particles = _particles(count, 4)
    pairs = [
        float(np.sum((a - b) ** 2))
        for i, a in enumerate(particles.numpy())
        for b in particles.numpy()[:i]
    ]
    expected = np.quantile(pairs, 0.5, method="lower")
    squared = _squared(particles)
    assert float(median_bandwidth(squared)) == pytest.approx(expected, rel=1e-12)
    liu = float(median_over_log_bandwidth(squared))
    assert liu == pytest.approx(expected / math.log(count), rel=1e-12)


def test_with_the_median_over_log_rule_the_median_pair_has_one_particles_share():
    gram, _ = RBF(median_over_log_bandwidth)(_particles(18, 50))
    rows, columns = torch.triu_indices(18, 18, 1)
    pairs = gram[rows, columns]
    assert np.quantile(pairs, 0.5, method="higher") == pytest.approx(1 / 18, rel=1e-12)


@pytest.mark.parametrize(
    "kernel", [RBF(), InverseMultiquadric(), MetricKernel(_metric(4))], ids=["rbf", "imq", "metric"]
)
def test_leading_dimensions_are_independent_sets(kernel):
    particles = _particles(2, 3, 6, 4) * torch.arange(1.0, 7.0).double().view(2, 3, 1, 1)
    batched = kernel(particles)
    for a in range(2):
        for b in range(3):
            single = kernel(particles[a, b])
            torch.testing.assert_close(batched.gram[a, b], single.gram)
            torch.testing.assert_close(batched.repulsion[a, b], single.repulsion)


@pytest.mark.parametrize("family", PROFILES)
@pytest.mark.parametrize("rule", [median_bandwidth, median_over_log_bandwidth])
@pytest.mark.parametrize("count", [1, 5])
def test_coinciding_particles_and_a_single_one_stay_finite(family, rule, count):
    gram, repulsion = family(rule)(torch.ones(count, 3, dtype=torch.float64))
    torch.testing.assert_close(gram, torch.ones_like(gram))
    torch.testing.assert_close(repulsion, torch.zeros_like(repulsion))


@pytest.mark.parametrize("family", PROFILES)
@pytest.mark.parametrize("bandwidth", [0.0, -1.0, math.nan, math.inf])
def test_a_bandwidth_that_is_not_positive_is_an_error(family, bandwidth):
    with pytest.raises(ValueError, match="bandwidth must be positive and finite"):
        family(bandwidth)


def test_a_metric_that_is_missing_or_does_not_fit_is_an_error():
    with pytest.raises(ValueError, match=r"root must have shape \(m, d\), got \(3,\)"):
        MetricKernel(torch.ones(3))
    with pytest.raises(ValueError, match="root must be finite"):
        MetricKernel(torch.full((2, 3), math.nan))
    with pytest.raises(ValueError, match="root of a MetricKernel must be given"):
        MetricKernel()(_particles(5, 3))
    with pytest.raises(ValueError, match=r"root must have shape \(m, 3\) for these particles"):
        MetricKernel(_metric(4))(_particles(5, 3))
