"""Kernels and bandwidths against autograd, brute force and numpy."""

import math

import numpy as np
import pytest
import torch

from smp_planner.inference.kernels import RBF, median_bandwidth, median_over_log_bandwidth


def _particles(*shape: int, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, generator=generator, dtype=torch.float64)


def _squared(particles: torch.Tensor) -> torch.Tensor:
    return (particles[..., :, None, :] - particles[..., None, :, :]).square().sum(-1)


@pytest.mark.parametrize(("count", "dimension"), [(42, 90), (7, 2), (2, 3)])
def test_gram_and_repulsion_agree_with_autograd(count, dimension):
    bandwidth = 1.3 * dimension
    particles = _particles(count, dimension)
    gram, repulsion = RBF(bandwidth)(particles)
    for i in range(min(count, 5)):
        summed = particles.clone().requires_grad_()
        kernel = torch.exp(-(summed - particles[i]).square().sum(-1) / bandwidth)
        torch.testing.assert_close(gram[i], kernel.detach(), atol=1e-13, rtol=1e-12)
        (gradient,) = torch.autograd.grad(kernel.sum(), summed)
        torch.testing.assert_close(repulsion[i], gradient.sum(0), atol=1e-12, rtol=1e-10)


def test_a_set_far_from_the_origin_loses_no_digits():
    particles = _particles(20, 5)
    near, far = RBF(3.0)(particles), RBF(3.0)(particles + 1e5)
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


def test_leading_dimensions_are_independent_sets():
    particles = _particles(2, 3, 6, 4) * torch.arange(1.0, 7.0).double().view(2, 3, 1, 1)
    batched = RBF(median_bandwidth)(particles)
    for a in range(2):
        for b in range(3):
            single = RBF(median_bandwidth)(particles[a, b])
            torch.testing.assert_close(batched.gram[a, b], single.gram)
            torch.testing.assert_close(batched.repulsion[a, b], single.repulsion)


@pytest.mark.parametrize("rule", [median_bandwidth, median_over_log_bandwidth])
@pytest.mark.parametrize("count", [1, 5])
def test_coinciding_particles_and_a_single_one_stay_finite(rule, count):
    gram, repulsion = RBF(rule)(torch.ones(count, 3, dtype=torch.float64))
    torch.testing.assert_close(gram, torch.ones_like(gram))
    torch.testing.assert_close(repulsion, torch.zeros_like(repulsion))


@pytest.mark.parametrize("bandwidth", [0.0, -1.0, math.nan, math.inf])
def test_a_bandwidth_that_is_not_positive_is_an_error(bandwidth):
    with pytest.raises(ValueError, match="bandwidth must be positive and finite"):
        RBF(bandwidth)
