"""Learning from demonstrations with gaps, against the dense likelihood of what is there."""

import math

import numpy as np
import pytest
import torch
from torch.distributions import MultivariateNormal

from smp_planner.movement_primitives import (
    EMSettings,
    GaussianBasis,
    ProMP,
    ProMPMixture,
    demonstrated_modes,
    phases,
    smooth_covariance,
)
from smp_planner.movement_primitives.em import expectation_maximization, fitted_weights

BASIS = GaussianBasis(7)
NOISE = torch.tensor([[4.0, 2.0, 0.0], [2.0, 3.0, -1.0], [0.0, -1.0, 2.0]]).double() * 1e-4


def _truth(dimension: int = 3) -> ProMP:
    mean = torch.linspace(-1, 1, 7 * dimension, dtype=torch.float64).sin()
    covariance = smooth_covariance(BASIS, dimension, 0.3, 0.3)
    return ProMP.from_covariance(BASIS, mean, covariance, NOISE[:dimension, :dimension])


def _demonstrations(count: int, samples: int, seed: int = 0) -> list[torch.Tensor]:
    truth, generator = _truth(), torch.Generator().manual_seed(seed)
    clean = truth.trajectory(truth.sample(count, generator), samples)
    shake = torch.randn(clean.shape, generator=generator, dtype=torch.float64)
    return list(clean + shake @ torch.linalg.cholesky(NOISE).mT)


def _with_gaps(demonstrations: list[torch.Tensor]) -> list[torch.Tensor]:
    """Take a run of whole samples from one in three, and single numbers from another."""
    broken = [d.clone() for d in demonstrations]
    for index, d in enumerate(broken):
        generator = torch.Generator().manual_seed(len(d))
        if index % 3 == 0:
            d[12:20] = math.nan
        elif index % 3 == 1:
            d[torch.rand(d.shape, generator=generator) < 0.2] = math.nan
    return broken


def _dense(d: torch.Tensor, mean, covariance, noise) -> torch.Tensor:
    """Return the log-density of the numbers of a demonstration that are there."""
    values = BASIS.values(phases(len(d)))
    design = torch.kron(values, torch.eye(d.shape[1], dtype=torch.float64))
    total = design @ covariance @ design.mT + torch.kron(torch.eye(len(d)).double(), noise)
    there = (~torch.isnan(d.flatten())).nonzero().flatten()
    return MultivariateNormal((design @ mean)[there], total[there[:, None], there]).log_prob(
        d.flatten()[there]
    )


def test_log_likelihood_is_that_of_what_is_there():
    truth = _truth()
    demonstrations = _with_gaps(_demonstrations(2, 30) + _demonstrations(2, 41, seed=1))
    for primitive in (truth, truth.condition(0.0, torch.zeros(3))):
        found = primitive.log_likelihood(demonstrations, nan_is_missing=True)
        for d, value in zip(demonstrations, found, strict=True):
            torch.testing.assert_close(
                value, _dense(d, primitive.mean, primitive.covariance, primitive.noise)
            )


def test_em_never_lowers_its_objective_and_ends_where_the_dense_likelihood_is_stationary():
    demonstrations = _with_gaps(_demonstrations(6, 25))
    settings = EMSettings(tolerance=1e-8, max_iterations=200, prior_std=0.1)
    learned = expectation_maximization(demonstrations, BASIS, settings)
    assert float(torch.tensor(learned.objective).diff().min()) > -1e-7
    mean, covariance, noise = (t.clone().requires_grad_() for t in learned[:3])
    penalty = torch.logdet(covariance) + settings.prior_std**2 * covariance.inverse().trace()
    penalised = sum(_dense(d, mean, covariance, noise) for d in demonstrations)
    penalised = penalised - 0.5 * settings.prior_count * penalty
    gradients = torch.autograd.grad(penalised, (mean, covariance, noise))
    for value, gradient in zip((mean, covariance, noise), gradients, strict=True):
        # Change of the objective for a change of one per cent of the parameter.
        assert float((0.01 * value * gradient).abs().max().detach()) < 2e-3


def test_the_model_is_recovered_through_the_gaps():
    count, truth = 200, _truth()
    demonstrations = _with_gaps(_demonstrations(100, 40) + _demonstrations(100, 50, seed=2))
    learned = expectation_maximization(demonstrations, BASIS, EMSettings(max_iterations=60))
    torch.testing.assert_close(learned.noise, NOISE, rtol=0, atol=0.05 * float(NOISE.max()))
    at = phases(30)
    error = truth.trajectory(learned.mean - truth.mean, at)
    assert float(error.abs().max()) < 4 * 0.35 / math.sqrt(count)


def test_a_gap_keeps_the_samples_beside_it_at_their_phases():
    line = phases(50)[:, None] * torch.tensor([1.0, -2.0]).double()
    gap = [line + 1e-3, line - 1e-3]
    for d in gap:
        d[10:25] = math.nan
    primitive = ProMP.fit(gap, BASIS, nan_is_missing=True)
    path = primitive.trajectory(primitive.mean, 50)
    torch.testing.assert_close(path, line, atol=5e-3, rtol=0)


def test_nothing_changes_where_nothing_is_missing():
    demonstrations = _demonstrations(5, 40)
    plain = ProMP.fit(demonstrations, BASIS)
    asked = ProMP.fit(demonstrations, BASIS, nan_is_missing=True)
    assert torch.equal(plain.mean, asked.mean)
    assert torch.equal(plain.factor, asked.factor)


def test_gaps_are_bridged_smoothly():
    phase = phases(50)[:, None]
    path = torch.cat([phase, (math.pi * phase).sin()], -1)
    broken = path.clone()
    broken[20:30] = math.nan
    broken[40:45, 1] = math.nan
    weights = fitted_weights(broken[None], GaussianBasis()).unflatten(-1, (-1, 2))
    found = GaussianBasis().values(phases(50)) @ weights[0]
    torch.testing.assert_close(found, path, atol=0.02, rtol=0)


def test_modes_are_found_through_gaps_and_unequal_lengths():
    rng = np.random.default_rng(0)
    paths = []
    for bend in [-1.0] * 4 + [1.0] * 4:
        phase = np.linspace(0.0, 1.0, rng.integers(40, 60))[:, None]
        path = np.hstack([phase, (bend + 0.1 * rng.standard_normal()) * np.sin(np.pi * phase)])
        path[rng.random(path.shape) < 0.3] = np.nan
        paths.append(path)
    groups = (tuple(range(4)), tuple(range(4, 8)))
    assert demonstrated_modes(paths, nan_is_missing=True) == groups
    mixture = ProMPMixture.fit(paths, BASIS, nan_is_missing=True, smooth_std=0.05)
    middle = [float(c.trajectory(c.mean, 3)[1, 1]) for c in mixture.components]
    assert middle == pytest.approx([-1.0, 1.0], abs=0.2)


@pytest.mark.parametrize("learn", [ProMP.fit, ProMPMixture.fit])
def test_nan_is_an_error_that_says_how_to_allow_it(learn):
    broken = _with_gaps(_demonstrations(3, 30))
    message = r"demonstrations\[0\] must be finite, .*; nan_is_missing=True takes NaN for samples"
    with pytest.raises(ValueError, match=message):
        learn(broken, BASIS)
    with pytest.raises(ValueError, match="must be finite"):
        _truth().log_likelihood(broken)


def test_infinity_and_a_dimension_without_samples_are_errors_all_the_same():
    demonstrations = _demonstrations(3, 30)
    demonstrations[1][4, 0] = math.inf
    with pytest.raises(ValueError, match=r"\[1\] must be finite, got \[inf, .* at sample 4$"):
        ProMP.fit(demonstrations, BASIS, nan_is_missing=True)
    demonstrations[1][:, 0] = math.nan
    demonstrations[1][7, 0] = 0.5
    message = r"demonstrations\[1\] must have at least 2 samples .*, got 1 in dimension 0"
    with pytest.raises(ValueError, match=message):
        ProMP.fit(demonstrations, BASIS, nan_is_missing=True)
