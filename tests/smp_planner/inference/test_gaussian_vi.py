import math

import pytest
import torch
from torch.distributions import MultivariateNormal, kl_divergence

from smp_planner.inference import GaussianVISettings, init_gaussian, step_gaussian
from smp_planner.inference.optimizers import GradientAscent


def draws(count, dimension, seed):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(count, dimension, generator=generator, dtype=torch.float64)


def test_a_gaussian_posterior_is_found():
    """Prior N(0, I) and C = (x - a)ᵀ A (x - a) / 2 have the posterior N((I+A)⁻¹ A a, (I+A)⁻¹)."""
    precision = torch.tensor([[1.0, 0.6, 0.0], [0.6, 3.0, -1.5], [0.0, -1.5, 6.0]]).double()
    target = torch.tensor([2.0, -1.0, 0.5], dtype=torch.float64)
    settings = GaussianVISettings(iterations=600, step_size=0.1, final_step=0.01)
    state = init_gaussian(3, settings)
    for iteration in range(600):
        noise = draws(42, 3, seed=100 + iteration)
        gradient = (state.particles(noise) - target) @ precision
        state = step_gaussian(state, noise, gradient, settings)
    covariance = torch.linalg.inv(torch.eye(3) + precision)
    mean = covariance @ precision @ target
    assert mean.norm() > 0.9
    assert covariance[1, 2].abs() > 0.05
    torch.testing.assert_close(state.mean, mean, atol=0.03, rtol=0.0)
    torch.testing.assert_close(state.factor @ state.factor.mT, covariance, atol=0.03, rtol=0.0)


def test_a_step_descends_the_gradient_of_the_bound():
    """Against autograd through the draws, and torch's divergence of two Gaussians."""
    settings = GaussianVISettings(
        optimizer=GradientAscent(), step_size=0.1, final_step=1.0, iterations=4
    )

    def cost(x):
        return (x.square().sum(-1) + torch.sin(3.0 * x[:, 0] * x[:, 1])).mean()

    prior = MultivariateNormal(torch.zeros(3).double(), torch.eye(3).double())
    state = init_gaussian(3, settings)
    for iteration in range(4):
        noise = draws(5, 3, seed=iteration)
        mean, lower, log_diagonal = (
            t.clone().requires_grad_() for t in (state.mean, state.lower, state.log_diagonal)
        )
        factor = lower.tril(-1) + torch.diag(log_diagonal.exp())
        bound = cost(mean + noise @ factor.mT)
        bound = bound + kl_divergence(MultivariateNormal(mean, scale_tril=factor), prior)
        bound.backward()
        x = state.particles(noise).requires_grad_()
        (len(x) * cost(x)).backward()
        after = step_gaussian(state, noise, x.grad, settings)
        for name, of in (("mean", mean), ("lower", lower), ("log_diagonal", log_diagonal)):
            change = getattr(after, name) - getattr(state, name)
            torch.testing.assert_close(change, -0.1 * of.grad)
        state = after
    assert state.lower.abs().max() > 1e-3


def test_without_a_cost_it_stays_the_prior():
    settings = GaussianVISettings(iterations=10)
    state = init_gaussian(4, settings)
    for iteration in range(10):
        noise = draws(8, 4, seed=iteration)
        state = step_gaussian(state, noise, torch.zeros(8, 4).double(), settings)
    assert torch.equal(state.mean, torch.zeros(4).double())
    assert torch.equal(state.factor, torch.eye(4).double())


@pytest.mark.parametrize(
    "change",
    [
        {"step_size": 0.0},
        {"step_size": math.inf},
        {"final_step": 1.5},
        {"final_step": -0.1},
        {"iterations": 0},
    ],
)
def test_settings_are_checked(change):
    with pytest.raises(ValueError, match=next(iter(change))):
        GaussianVISettings(**change)


def test_wrong_arguments_are_named():
    settings = GaussianVISettings(iterations=1)
    with pytest.raises(ValueError, match="dimension must be at least 1, got 0"):
        init_gaussian(0, settings)
    state = init_gaussian(3, settings)
    noise = draws(5, 3, seed=0)
    with pytest.raises(ValueError, match=r"noise must have shape \(P, 3\), got \(5, 2\)"):
        step_gaussian(state, noise[:, :2], noise, settings)
    with pytest.raises(ValueError, match=r"gradient must have the shape \(5, 3\)"):
        step_gaussian(state, noise, noise[:4], settings)
    with pytest.raises(ValueError, match="gradient must be finite"):
        step_gaussian(state, noise, noise * math.nan, settings)
    done = step_gaussian(state, noise, noise, settings)
    with pytest.raises(ValueError, match="iteration"):
        step_gaussian(done, noise, noise, settings)
