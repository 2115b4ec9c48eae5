"""Primitives against dense Gaussian formulas, torch's and scipy's distributions, and sampling."""

import math

import numpy as np
import pytest
import torch
from scipy.stats import multivariate_normal
from torch.distributions import MultivariateNormal

from smp_planner.movement_primitives import (
    EMSettings,
    GaussianBasis,
    ProMP,
    phases,
    smooth_covariance,
)
from smp_planner.movement_primitives.em import expectation_maximization

BASIS = GaussianBasis(7)
DIMENSION = 2
SIZE = 7 * DIMENSION


def _generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def _normal(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=_generator(seed), dtype=torch.float64)


def _moments(seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """Return a mean and a well-conditioned covariance of weights."""
    root = _normal(SIZE, SIZE, seed=seed + 1) / math.sqrt(SIZE)
    return _normal(SIZE, seed=seed), root @ root.mT + 0.1 * torch.eye(SIZE, dtype=torch.float64)


def _primitive(seed: int = 0) -> ProMP:
    mean, covariance = _moments(seed)
    return ProMP.from_covariance(BASIS, mean, covariance, torch.tensor([0.01, 0.04]).double())


def _rows(phase: float, derivative: bool) -> torch.Tensor:
    """Return the (D, K*D) observation matrix, written out entry by entry."""
    at = torch.tensor(phase, dtype=torch.float64)
    values = BASIS.derivatives(at) if derivative else BASIS.values(at)
    rows = torch.zeros(DIMENSION, SIZE, dtype=torch.float64)
    for k in range(7):
        for d in range(DIMENSION):
            rows[d, k * DIMENSION + d] = values[k]
    return rows


def _design(samples: int) -> torch.Tensor:
    """Return the (T*D, K*D) map from weights to a flattened trajectory."""
    return torch.cat([_rows(float(z), False) for z in phases(samples)])


def _dense_posterior(
    mean: torch.Tensor,
    covariance: torch.Tensor,
    rows: torch.Tensor,
    value: torch.Tensor,
    noise: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor]:
    gain = covariance @ rows.mT @ torch.linalg.inv(rows @ covariance @ rows.mT + noise)
    return mean + gain @ (value - rows @ mean), covariance - gain @ rows @ covariance


VALUE = torch.tensor([0.3, -0.7], dtype=torch.float64)
NOISES = {
    "full": torch.tensor([[0.05, 0.02], [0.02, 0.03]], dtype=torch.float64),
    "one exact": torch.tensor([[0.04, 0.0], [0.0, 0.0]], dtype=torch.float64),
    "singular": torch.tensor([[0.04, 0.02], [0.02, 0.01]], dtype=torch.float64),
    "exact": torch.zeros(2, 2, dtype=torch.float64),
}


@pytest.mark.parametrize("derivative", [False, True])
@pytest.mark.parametrize("phase", [0.0, 0.37, 1.0])
@pytest.mark.parametrize("noise", NOISES)
def test_conditioning_agrees_with_the_dense_formula(noise, phase, derivative):
    mean, covariance = _moments()
    rows = _rows(phase, derivative)
    expected = _dense_posterior(mean, covariance, rows, VALUE, NOISES[noise])
    posterior = _primitive().condition(phase, VALUE, NOISES[noise], derivative=derivative)
    torch.testing.assert_close(posterior.mean, expected[0], atol=1e-10, rtol=1e-10)
    torch.testing.assert_close(posterior.covariance, expected[1], atol=1e-10, rtol=1e-10)


def test_conditioning_agrees_with_weighted_samples():
    primitive, std = _primitive(), 0.4
    weights = primitive.sample(400_000, _generator(3))
    position = weights @ _rows(0.4, False).mT
    importance = torch.softmax(-0.5 * ((position - VALUE) / std).square().sum(-1), 0)
    posterior = primitive.condition(0.4, VALUE, torch.full((2,), std**2).double())
    mean = importance @ weights
    centred = weights - mean
    covariance = (centred * importance[:, None]).mT @ centred
    # Effective sample size is over 10^4: five standard errors of variances of order one.
    torch.testing.assert_close(posterior.mean, mean, atol=0.05, rtol=0)
    torch.testing.assert_close(posterior.covariance, covariance, atol=0.05, rtol=0)


def test_exact_conditions_hold_exactly_in_every_sample_and_take_dimensions_away():
    primitive = ProMP.fit(_demonstrations(5, 60)[0])
    free = primitive.rank
    zero = torch.zeros(DIMENSION, dtype=torch.float64)
    for phase, value, derivative in ((0.0, VALUE, False), (0.0, zero, True), (1.0, zero, True)):
        primitive = primitive.condition(phase, value, derivative=derivative)
    assert primitive.rank == free - 3 * DIMENSION
    weights = primitive.sample(100, _generator())
    start = primitive.trajectory(weights, 200)[:, 0]
    torch.testing.assert_close(start, VALUE.expand_as(start), atol=1e-13, rtol=0)
    assert float(primitive.velocity(weights, 200)[:, [0, -1]].abs().max()) < 1e-11
    assert float(torch.linalg.eigvalsh(primitive.covariance)[0]) > -1e-15
    assert float(primitive.marginal(0.5)[1].diagonal().min()) > 0.1**2


def test_exact_is_the_limit_of_ever_smaller_noise():
    exact = _primitive().condition(0.2, VALUE)
    nearly = _primitive().condition(0.2, VALUE, torch.full((2,), 1e-12).double())
    torch.testing.assert_close(nearly.mean, exact.mean, atol=1e-9, rtol=0)
    torch.testing.assert_close(nearly.covariance, exact.covariance, atol=1e-9, rtol=0)


def test_conditioning_twice_on_the_same_changes_nothing():
    once = _primitive().condition(0.2, VALUE)
    twice = once.condition(0.2, VALUE)
    assert twice.rank == once.rank
    torch.testing.assert_close(twice.mean, once.mean)
    torch.testing.assert_close(twice.covariance, once.covariance, atol=1e-13, rtol=0)


def test_what_is_certain_can_not_be_contradicted():
    certain = _primitive().condition(0.2, VALUE)
    with pytest.raises(ValueError, match=r"at phase 0\.2 contradicts what is certain there"):
        certain.condition(0.2, VALUE + 1e-3)


def test_conditioning_until_nothing_is_free_interpolates():
    basis, at = GaussianBasis(4), torch.tensor([0.0, 0.3, 0.6, 1.0], dtype=torch.float64)
    values = torch.tensor([[0.2], [-0.5], [0.7], [0.1]], dtype=torch.float64)
    primitive = ProMP(basis, torch.ones(4).double(), torch.eye(4).double(), torch.ones(1).double())
    for phase, value in zip(at, values, strict=True):
        primitive = primitive.condition(float(phase), value)
    assert primitive.rank == 0
    weights = primitive.sample(3, _generator())
    path = primitive.trajectory(weights, at)
    torch.testing.assert_close(path, values.expand(3, 4, 1), atol=1e-12, rtol=0)
    torch.testing.assert_close(primitive.project(torch.zeros(4).double()), weights[0])
    assert float(primitive.score(weights).abs().max()) == 0.0
    primitive.condition(0.3, values[1])
    with pytest.raises(ValueError, match="contradicts"):
        primitive.condition(0.3, values[2])


def test_order_of_conditions_does_not_matter():
    end = torch.tensor([1.0, 2.0], dtype=torch.float64)
    a = _primitive().condition(0.0, VALUE).condition(1.0, end, NOISES["full"])
    b = _primitive().condition(1.0, end, NOISES["full"]).condition(0.0, VALUE)
    torch.testing.assert_close(a.mean, b.mean, atol=1e-10, rtol=0)
    torch.testing.assert_close(a.covariance, b.covariance, atol=1e-10, rtol=0)


def test_several_values_at_once_are_several_primitives():
    values = _normal(3, 1, DIMENSION, seed=9)
    batched = _primitive().condition(0.1, values).condition(1.0, VALUE, derivative=True)
    assert batched.mean.shape == (3, 1, SIZE)
    assert batched.sample(5, _generator()).shape == (5, 3, 1, SIZE)
    for index in range(3):
        single = _primitive().condition(0.1, values[index, 0])
        single = single.condition(1.0, VALUE, derivative=True)
        torch.testing.assert_close(batched.mean[index, 0], single.mean, atol=1e-11, rtol=0)
        torch.testing.assert_close(batched.covariance, single.covariance, atol=1e-11, rtol=0)


def test_log_prob_and_score_agree_with_torch():
    mean, covariance = _moments()
    reference = MultivariateNormal(mean, covariance)
    weights = _normal(3, 5, SIZE, seed=4).requires_grad_()
    log_prob = reference.log_prob(weights)
    (score,) = torch.autograd.grad(log_prob.sum(), weights)
    primitive = _primitive()
    torch.testing.assert_close(primitive.log_prob(weights.detach()), log_prob.detach())
    torch.testing.assert_close(primitive.score(weights.detach()), score, atol=1e-9, rtol=1e-9)


@pytest.mark.parametrize("dimension", [2, 3, 6])
@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
def test_batches_keep_their_shape_in_every_dimension(dimension, batch):
    size = 7 * dimension
    root = _normal(size, size, seed=1) / math.sqrt(size)
    covariance = root @ root.mT + 0.1 * torch.eye(size, dtype=torch.float64)
    mean, noise = _normal(size), torch.ones(dimension, dtype=torch.float64)
    primitive = ProMP.from_covariance(BASIS, mean, covariance, noise)
    reference = MultivariateNormal(mean, covariance)
    weights = _normal(*batch, size, seed=2).requires_grad_()
    (score,) = torch.autograd.grad(reference.log_prob(weights).sum(), weights)
    weights = weights.detach()
    torch.testing.assert_close(primitive.log_prob(weights), reference.log_prob(weights))
    torch.testing.assert_close(primitive.score(weights), score, atol=1e-9, rtol=1e-9)
    torch.testing.assert_close(primitive.unwhiten(primitive.whiten(weights)), weights)
    assert primitive.sample(5, _generator()).shape == (5, size)
    assert primitive.trajectory(weights, 11).shape == (*batch, 11, dimension)
    assert primitive.velocity(weights, 11).shape == (*batch, 11, dimension)

    value, std = _normal(*batch, dimension, seed=3), 0.1
    noise = torch.full((dimension,), std**2, dtype=torch.float64)
    posterior = primitive.condition(0.6, value, noise).condition(1.0, 0 * value, derivative=True)
    assert posterior.mean.shape == (*batch, size)
    assert posterior.sample(5, _generator()).shape == (5, *batch, size)
    identity = torch.eye(dimension, dtype=torch.float64)
    rows = torch.kron(BASIS.values(torch.tensor([0.6], dtype=torch.float64)), identity)
    end = torch.kron(BASIS.derivatives(torch.tensor([1.0], dtype=torch.float64)), identity)
    gaussian = std**2 * identity
    for index in np.ndindex(*batch):
        expected = _dense_posterior(mean, covariance, rows, value[index], gaussian)
        expected = _dense_posterior(*expected, end, 0 * value[index], 0 * identity)
        torch.testing.assert_close(posterior.mean[index], expected[0], atol=1e-9, rtol=0)
        torch.testing.assert_close(posterior.covariance, expected[1], atol=1e-9, rtol=0)


def test_log_prob_of_a_singular_primitive_agrees_with_scipy():
    primitive = _primitive().condition(0.0, VALUE)
    weights = primitive.sample(6, _generator())
    expected = multivariate_normal(
        primitive.mean.numpy(), primitive.covariance.numpy(), allow_singular=True
    ).logpdf(weights.numpy())
    np.testing.assert_allclose(primitive.log_prob(weights).numpy(), expected, rtol=1e-9)


def test_score_of_a_singular_primitive_agrees_with_finite_differences_and_keeps_what_is_certain():
    primitive = _primitive().condition(0.0, VALUE)
    weights = primitive.sample(4, _generator())
    score, step = primitive.score(weights), 1e-6
    for index in range(SIZE):
        shift = torch.zeros(SIZE, dtype=torch.float64)
        shift[index] = step
        difference = primitive.log_prob(weights + shift) - primitive.log_prob(weights - shift)
        torch.testing.assert_close(score[:, index], difference / (2 * step), atol=1e-6, rtol=1e-6)
    assert float((score @ _rows(0.0, False).mT).abs().max()) < 1e-10


def test_samples_have_the_moments_of_the_primitive():
    mean, covariance = _moments()
    weights = _primitive().sample(100_000, _generator(2))
    # Five standard errors of variances up to about 3.
    torch.testing.assert_close(weights.mean(0), mean, atol=0.03, rtol=0)
    torch.testing.assert_close(torch.cov(weights.mT), covariance, atol=0.07, rtol=0)


def test_samples_come_from_the_generator_only():
    first, again = (_primitive().sample(3, _generator(7)) for _ in range(2))
    assert torch.equal(first, again)
    assert not torch.equal(first, _primitive().sample(3, _generator(8)))


def test_whitened_weights_are_standard_normal_and_come_back():
    primitive = _primitive().condition(0.5, VALUE)
    weights = primitive.sample(50_000, _generator(1))
    latent = primitive.whiten(weights)
    assert latent.shape == (50_000, SIZE - DIMENSION)
    identity = torch.eye(SIZE - DIMENSION, dtype=torch.float64)
    torch.testing.assert_close(torch.cov(latent.mT), identity, atol=0.03, rtol=0)
    torch.testing.assert_close(primitive.unwhiten(latent), weights, atol=1e-12, rtol=0)


def test_whitened_gradient_agrees_with_autograd():
    primitive = _primitive().condition(0.5, VALUE)
    latent = _normal(4, primitive.rank).requires_grad_()
    weights = primitive.unwhiten(latent)
    (expected,) = torch.autograd.grad(weights.sin().sum(), latent)
    torch.testing.assert_close(primitive.whiten_gradient(weights.detach().cos()), expected)


def test_projection_is_the_nearest_possible_point():
    primitive = _primitive().condition(0.5, VALUE)
    weights = _normal(8, SIZE, seed=11)
    projected = primitive.project(weights)
    position = projected @ _rows(0.5, False).mT
    torch.testing.assert_close(position, VALUE.expand_as(position), atol=1e-12, rtol=0)
    along = (weights - projected) @ primitive.factor
    assert float(along.abs().max()) < 1e-12


def test_factor_keeps_the_covariance_in_orthogonal_columns():
    factor = _normal(SIZE, 20, seed=5)
    primitive = ProMP(BASIS, torch.zeros(SIZE).double(), factor, torch.ones(2).double())
    assert primitive.rank == SIZE
    torch.testing.assert_close(primitive.covariance, factor @ factor.mT)
    products = primitive.factor.mT @ primitive.factor
    lengths = products.diagonal()
    torch.testing.assert_close(products, torch.diag(lengths), atol=1e-12, rtol=0)
    assert bool((lengths.diff() <= 0).all())


def test_trajectory_velocity_and_pull_back():
    primitive, weights = _primitive(), _normal(2, 3, SIZE, seed=6).requires_grad_()
    trajectory = primitive.trajectory(weights, 11)
    assert trajectory.shape == (2, 3, 11, DIMENSION)
    expected = (weights @ _design(11).mT).unflatten(-1, (11, DIMENSION))
    torch.testing.assert_close(trajectory, expected)

    (gradient,) = torch.autograd.grad(trajectory.sin().sum(), weights)
    pulled = primitive.pull_back(trajectory.detach().cos(), 11)
    torch.testing.assert_close(pulled, gradient)

    at, step = torch.linspace(0.1, 0.9, 9).double(), 1e-6
    ahead, behind = (primitive.trajectory(weights.detach(), at + s) for s in (step, -step))
    velocity = primitive.velocity(weights.detach(), at)
    torch.testing.assert_close(velocity, (ahead - behind) / (2 * step), atol=1e-7, rtol=1e-7)


def test_marginal_agrees_with_samples():
    primitive = _primitive()
    weights = primitive.sample(100_000, _generator(4))
    for derivative, draw in ((False, primitive.trajectory), (True, primitive.velocity)):
        mean, covariance = primitive.marginal(0.6, derivative=derivative)
        samples = draw(weights, torch.tensor([0.6]))[:, 0]
        scale = float(covariance.diagonal().max())
        torch.testing.assert_close(samples.mean(0), mean, atol=0.02 * scale**0.5, rtol=0)
        torch.testing.assert_close(torch.cov(samples.mT), covariance, atol=0.03 * scale, rtol=0)


# Learning


def _demonstrations(
    count: int, samples: int, noise: float = 0.02, seed: int = 0
) -> tuple[list[torch.Tensor], torch.Tensor, torch.Tensor]:
    """Draw demonstrations from a known model; return them with its mean and covariance."""
    mean = _normal(SIZE, seed=100)
    covariance = smooth_covariance(BASIS, DIMENSION, 0.3, 0.3)
    truth = ProMP.from_covariance(BASIS, mean, covariance, torch.full((2,), noise**2).double())
    generator = _generator(seed)
    weights = truth.sample(count, generator)
    clean = truth.trajectory(weights, samples)
    shake = torch.randn(clean.shape, generator=generator, dtype=torch.float64)
    return list(clean + noise * shake), mean, covariance


def test_em_recovers_the_model_that_made_the_demonstrations():
    count, samples = 300, 50
    demonstrations, mean, covariance = _demonstrations(count, samples)
    learned = expectation_maximization(demonstrations, BASIS)
    std = learned.noise.diagonal().sqrt()
    torch.testing.assert_close(std, torch.full_like(std, 0.02), rtol=0.02, atol=0)
    assert float(learned.noise[0, 1].abs()) < 0.02**2 * 0.05
    design = _design(samples)
    difference = design @ (learned.mean - mean)
    standard_error = 0.35 / math.sqrt(count)
    assert float(difference.abs().max()) < 4 * standard_error
    true, found = (design @ c @ design.mT for c in (covariance, learned.covariance))
    relative = torch.linalg.matrix_norm(found - true) / torch.linalg.matrix_norm(true)
    assert float(relative) < 4 / math.sqrt(count)


def test_em_never_lowers_its_objective():
    demonstrations = _demonstrations(5, 30)[0] + _demonstrations(3, 44, seed=1)[0]
    objective = torch.tensor(expectation_maximization(demonstrations, BASIS).objective)
    assert len(objective) > 3
    assert float(objective.diff().min()) > -1e-8


def test_em_ends_where_the_dense_likelihood_is_stationary():
    demonstrations = _demonstrations(4, 25)[0] + _demonstrations(2, 31, seed=1)[0]
    settings = EMSettings(tolerance=1e-13, max_iterations=5000, prior_std=0.1)
    learned = expectation_maximization(demonstrations, BASIS, settings)
    mean, covariance, noise = (t.clone().requires_grad_() for t in learned[:3])
    penalised = (
        -0.5
        * settings.prior_count
        * (torch.logdet(covariance) + settings.prior_std**2 * torch.linalg.inv(covariance).trace())
    )
    for d in demonstrations:
        design = _design(len(d))
        total = design @ covariance @ design.mT + torch.kron(
            torch.eye(len(d), dtype=torch.float64), noise
        )
        penalised = penalised + MultivariateNormal(design @ mean, total).log_prob(d.flatten())
    for value, gradient in zip(
        (mean, covariance, noise),
        torch.autograd.grad(penalised, (mean, covariance, noise)),
        strict=True,
    ):
        # Change of the objective for a change of one per cent of the parameter.
        assert float((0.01 * value * gradient).abs().max().detach()) < 1e-3


def test_log_likelihood_agrees_with_the_dense_gaussian():
    for primitive in (_primitive(), _primitive().condition(0.0, VALUE)):
        demonstrations = [_normal(12, DIMENSION, seed=1), _normal(9, DIMENSION, seed=2)]
        for d, found in zip(demonstrations, primitive.log_likelihood(demonstrations), strict=True):
            design = _design(len(d))
            total = design @ primitive.covariance @ design.mT + torch.kron(
                torch.eye(len(d), dtype=torch.float64), primitive.noise
            )
            reference = MultivariateNormal(design @ primitive.mean, total)
            torch.testing.assert_close(found, reference.log_prob(d.flatten()))


def test_fit_adds_the_stated_freedom_to_demonstrations_that_have_none():
    line = phases(200)[:, None] * torch.tensor([1.0, -2.0, 0.5]).double()
    primitive = ProMP.fit([line + 1e-4, line - 1e-4], smooth_std=0.2)
    weights = primitive.sample(20_000, _generator())
    trajectories = primitive.trajectory(weights, torch.tensor([0.45, 0.5]))
    std = trajectories[:, 1].std(0)
    torch.testing.assert_close(std, torch.full_like(std, 0.2), rtol=0.03, atol=0)
    nearby = torch.corrcoef(trajectories[:, :, 0].mT)[0, 1]
    assert float(nearby) > 0.95
    joints = torch.corrcoef(trajectories[:, 1].mT)
    torch.testing.assert_close(joints, torch.eye(3).double(), atol=0.03, rtol=0)


@pytest.mark.parametrize("phase", [0.25, 0.5, 0.75])
def test_smooth_covariance_has_the_stated_std_and_nearly_its_length_scale(phase):
    basis, std, length_scale = GaussianBasis(40), 0.2, 0.2
    primitive = ProMP.from_covariance(
        basis,
        torch.zeros(40 * 3).double(),
        smooth_covariance(basis, 3, std, length_scale),
        torch.ones(3).double(),
    )
    _, position = primitive.marginal(phase)
    identity = torch.eye(3, dtype=torch.float64)
    torch.testing.assert_close(position, std**2 * identity, rtol=1e-3, atol=1e-12)
    # A process with that kernel has velocities of std / length scale (Rasmussen & Williams, 9.4).
    _, velocity = primitive.marginal(phase, derivative=True)
    torch.testing.assert_close(
        velocity, (std / length_scale) ** 2 * identity, rtol=0.05, atol=1e-12
    )


def test_fit_takes_unequal_lengths_and_arrays():
    demonstrations = _demonstrations(3, 40)[0] + _demonstrations(3, 55, seed=1)[0]
    a = ProMP.fit(demonstrations, BASIS)
    b = ProMP.fit([d.numpy() for d in demonstrations], BASIS)
    torch.testing.assert_close(a.mean, b.mean)
    middle = a.trajectory(a.mean, 3)[1]
    average = torch.stack([d[len(d) // 2] for d in demonstrations]).mean(0)
    assert float((middle - average).abs().max()) < 0.05


def test_fit_takes_a_constant_dimension():
    demonstrations = torch.stack(_demonstrations(4, 50)[0])
    demonstrations[..., 1] = 0.5
    primitive = ProMP.fit(demonstrations, BASIS)
    path = primitive.trajectory(primitive.mean, 20)[:, 1]
    torch.testing.assert_close(path, torch.full_like(path, 0.5), atol=1e-3, rtol=0)
    assert float(primitive.noise[1, 1].sqrt()) < 1e-3
    assert float(primitive.marginal(0.5)[1][1, 1].sqrt()) == pytest.approx(0.2, rel=0.05)


def test_broadening_adds_a_covariance():
    added = smooth_covariance(BASIS, DIMENSION, 0.5, 0.2)
    primitive = _primitive()
    broad = primitive.broaden(added)
    torch.testing.assert_close(broad.covariance, primitive.covariance + added)
    torch.testing.assert_close(broad.mean, primitive.mean)


def test_single_precision_stays_single_precision():
    demonstrations = torch.stack(_demonstrations(5, 50)[0])
    double = ProMP.fit(demonstrations, BASIS).condition(0.0, VALUE)
    single = ProMP.fit(demonstrations.float(), BASIS).condition(0.0, VALUE)
    assert single.mean.dtype == single.factor.dtype == torch.float32
    weights = single.sample(4, _generator())
    start = single.trajectory(weights, 50)[:, 0]
    torch.testing.assert_close(start, VALUE.float().expand_as(start), atol=1e-5, rtol=0)
    torch.testing.assert_close(
        single.covariance.double(), double.covariance, atol=2e-3 * 0.3, rtol=0
    )


# Bad input

GOOD = [_normal(20, 2, seed=1), _normal(25, 2, seed=2)]
NAN = torch.full((20, 2), math.nan).double()


@pytest.mark.parametrize(
    ("demonstrations", "message"),
    [
        ([], "demonstrations must be at least 2, got 0"),
        (GOOD[:1], "demonstrations must be at least 2, got 1"),
        ([*GOOD, _normal(20, 3)], r"one dimension: demonstrations\[2\] has 3, .* has 2"),
        ([*GOOD, _normal(20)], r"demonstrations\[2\] must have shape \(T, D\)"),
        ([*GOOD, _normal(1, 2)], r"demonstrations\[2\] must have shape .* got \(1, 2\)"),
        ([*GOOD, NAN], r"demonstrations\[2\] must be finite, got \[nan, nan\] at sample 0"),
    ],
)
def test_bad_demonstrations_are_errors(demonstrations, message):
    with pytest.raises(ValueError, match=message):
        ProMP.fit(demonstrations)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"smooth_std": -0.1}, "smooth_std must be .* at least 0.0, got -0.1"),
        ({"smooth_length_scale": 0.0}, "smooth_length_scale must be .* above 0.0"),
    ],
)
def test_bad_smoothness_is_an_error(arguments, message):
    with pytest.raises(ValueError, match=message):
        ProMP.fit(GOOD, **arguments)


@pytest.mark.parametrize("name", ["prior_std", "prior_count", "noise_std_floor", "tolerance"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan])
def test_bad_em_settings_are_errors(name, value):
    with pytest.raises(ValueError, match=rf"EMSettings\.{name} must be positive"):
        EMSettings(**{name: value})


ASYMMETRIC = torch.tensor([[1.0, 0.5], [0.0, 1.0]]).double()
INDEFINITE = torch.tensor([[1.0, 2.0], [2.0, 1.0]]).double()


@pytest.mark.parametrize(
    ("phase", "value", "covariance", "message"),
    [
        (1.1, VALUE, None, r"phase must be in \[0, 1\], got 1\.1"),
        (0.5, torch.zeros(3), None, r"value must have shape \(\.\.\., 2\), got \(3,\)"),
        (0.5, VALUE * math.nan, None, "value must be finite"),
        (0.5, VALUE, torch.eye(3), r"covariance must have shape \(2, 2\) or \(2,\)"),
        (0.5, VALUE, ASYMMETRIC, "covariance must be symmetric"),
        (0.5, VALUE, INDEFINITE, "covariance must be positive semi-definite"),
        (0.5, VALUE, torch.tensor([-1.0, 1.0]), "covariance must be positive semi-definite"),
        (0.5, VALUE, torch.eye(2) * math.nan, "covariance must be finite"),
    ],
)
def test_bad_conditions_are_errors(phase, value, covariance, message):
    with pytest.raises(ValueError, match=message):
        _primitive().condition(phase, value, covariance)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mean": torch.zeros(13).double()}, r"mean must have shape \(\.\.\., K \* D = 7 \* 2\)"),
        ({"mean": torch.full((14,), math.nan).double()}, "mean must be finite"),
        ({"root": torch.zeros(13, 2).double()}, r"root must be \(14, m\)"),
        ({"root": torch.full((14, 2), math.inf).double()}, "root must be finite"),
        ({"noise": torch.zeros(2).double()}, "noise must be positive definite"),
        ({"noise": ASYMMETRIC}, "noise must be symmetric"),
        ({"noise": torch.tensor(1.0)}, r"noise must be \(D,\) or \(D, D\)"),
    ],
)
def test_a_primitive_that_does_not_fit_together_is_an_error(change, message):
    good = {"mean": torch.zeros(14), "root": torch.eye(14), "noise": torch.ones(2)}
    with pytest.raises(ValueError, match=message):
        ProMP(BASIS, **{**good, **change})


@pytest.mark.parametrize("phase", [-0.01, 1.01, math.nan])
def test_phases_outside_the_primitive_are_errors(phase):
    primitive, at = _primitive(), torch.tensor([0.5, phase], dtype=torch.float64)
    message = r"phase must be in \[0, 1\], got"
    for draw in (primitive.trajectory, primitive.velocity):
        with pytest.raises(ValueError, match=message):
            draw(primitive.mean, at)
    for derivative in (False, True):
        with pytest.raises(ValueError, match=message):
            primitive.marginal(phase, derivative=derivative)
        with pytest.raises(ValueError, match=message):
            primitive.condition(phase, VALUE, derivative=derivative)


def test_covariances_that_are_none_are_errors():
    with pytest.raises(ValueError, match="covariance must be positive semi-definite"):
        ProMP.from_covariance(BASIS, torch.zeros(14), -torch.eye(14), torch.ones(2))
    with pytest.raises(ValueError, match=r"covariance must have shape \(14, 14\)"):
        _primitive().broaden(torch.eye(3))


def test_weights_of_another_length_are_errors():
    with pytest.raises(ValueError, match=r"weights must have shape \(\.\.\., 14\), got \(3, 7\)"):
        _primitive().trajectory(torch.zeros(3, 7).double(), 10)
