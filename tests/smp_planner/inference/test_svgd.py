"""Stein variational gradient descent against analytic posteriors and the definition in loops."""

import math
from dataclasses import replace

import pytest
import torch
from torch.distributions import Categorical, MixtureSameFamily, MultivariateNormal

from smp_planner.inference import (
    RBF,
    SETTINGS,
    State,
    SVGDSettings,
    init,
    median_bandwidth,
    named_settings,
    stein_direction,
    step,
)
from smp_planner.inference.annealing import cyclic_annealing, tanh_annealing
from smp_planner.inference.optimizers import GradientAscent
from smp_planner.inference.stein_kernels import KernelTerms
from smp_planner.movement_primitives import GaussianBasis, ProMP, smooth_covariance

PATIENT = SVGDSettings(step_size=0.1, final_step=0.01, iterations=500)
PLAIN = SVGDSettings(optimizer=GradientAscent(), final_step=1.0, annealing=0.0)


def _normal(*shape: int, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, generator=generator, dtype=torch.float64)


def _gaussian(dimension: int) -> MultivariateNormal:
    root = torch.eye(dimension, dtype=torch.float64) + 0.3 * _normal(dimension, dimension, seed=5)
    mean = torch.linspace(-1, 1, dimension, dtype=torch.float64)
    return MultivariateNormal(mean, root @ root.mT)


def _score(target, particles: torch.Tensor) -> torch.Tensor:
    particles = particles.clone().requires_grad_()
    (score,) = torch.autograd.grad(target.log_prob(particles).sum(), particles)
    return score


def _run(target, particles: torch.Tensor, settings: SVGDSettings) -> torch.Tensor:
    state = init(particles, settings)
    for _ in range(settings.iterations):
        score = _score(target, state.particles)
        state = step(state, score, torch.zeros_like(score), settings)
    return state.particles


@pytest.mark.parametrize(
    ("dimension", "mean_tolerance", "covariance_tolerance"),
    # Known: a finite set under-estimates variance, and the more the higher the dimension.
    [(2, 0.01, 0.03), (10, 0.03, 0.10)],
)
def test_particles_take_the_moments_of_a_gaussian(dimension, mean_tolerance, covariance_tolerance):
    target = _gaussian(dimension)
    particles = _run(target, _normal(200, dimension), PATIENT)
    assert float((particles.mean(0) - target.mean).abs().max()) < mean_tolerance
    error = torch.cov(particles.mT, correction=0) - target.covariance_matrix
    relative = torch.linalg.matrix_norm(error) / torch.linalg.matrix_norm(target.covariance_matrix)
    assert float(relative) < covariance_tolerance


def _linear_kernel(particles: torch.Tensor) -> KernelTerms:
    gram = particles @ particles.mT + 1.0
    return KernelTerms(gram, len(particles) * particles)


def test_with_a_linear_kernel_the_moments_are_exact():
    # Liu & Wang 2018, SVGD as Moment Matching, Theorem 3.3: any fixed point has both moments.
    target = _gaussian(10)
    settings = replace(PLAIN, kernel=_linear_kernel, step_size=0.02, iterations=3000)
    particles = _run(target, _normal(30, 10), settings)
    torch.testing.assert_close(particles.mean(0), target.mean, atol=1e-6, rtol=0)
    covariance = torch.cov(particles.mT, correction=0)
    torch.testing.assert_close(covariance, target.covariance_matrix, atol=1e-6, rtol=0)


def test_particles_cover_both_modes_of_a_mixture():
    weights = torch.tensor([0.35, 0.65], dtype=torch.float64)
    means = torch.tensor([[-1.2, 0.0], [1.2, 0.5]], dtype=torch.float64)
    variance = 0.36
    target = MixtureSameFamily(
        Categorical(weights),
        MultivariateNormal(means, variance * torch.eye(2, dtype=torch.float64)),
    )
    particles = _run(target, 2.0 * _normal(150, 2), PATIENT)
    mean = weights @ means
    # Few particles change modes, so the modes' shares are right to a few per cent only, and five
    # per cent of the distance of 2.4 between the modes is allowed.
    torch.testing.assert_close(particles.mean(0), mean, atol=0.12, rtol=0)
    centred = means - mean
    covariance = (centred.mT * weights) @ centred + variance * torch.eye(2, dtype=torch.float64)
    found = torch.cov(particles.mT, correction=0)
    torch.testing.assert_close(found, covariance, atol=0.07 * float(covariance.max()), rtol=0)
    right = torch.cdist(particles, means).argmin(-1).double().mean()
    exact = _share_nearer_to_the_second(weights, means, math.sqrt(variance))
    assert float(right) == pytest.approx(exact, abs=0.05)


def _share_nearer_to_the_second(weights, means, std) -> float:
    half_distance = float((means[1] - means[0]).norm()) / 2
    wrong = 0.5 * math.erfc(half_distance / std / math.sqrt(2))
    return float(weights[1] * (1 - wrong) + weights[0] * wrong)


def test_direction_is_the_definition_written_in_loops():
    particles, score, bandwidth = _normal(6, 3), _normal(6, 3, seed=1), 2.5
    expected = torch.zeros(6, 3, dtype=torch.float64)
    for i in range(6):
        for j in range(6):
            summed = particles[j].clone().requires_grad_()
            kernel = torch.exp(-(summed - particles[i]).square().sum() / bandwidth)
            (gradient,) = torch.autograd.grad(kernel, summed)
            expected[i] += (0.3 * kernel.detach() * score[j] + gradient) / 6
    found = stein_direction(particles, score, RBF(bandwidth), attraction=0.3)
    torch.testing.assert_close(found, expected, atol=1e-13, rtol=1e-11)


def test_rows_of_the_gram_matrix_belong_to_the_particle_that_moves():
    gram, repulsion = _normal(6, 6, seed=2), _normal(6, 3, seed=3)
    score = _normal(6, 3, seed=1)
    found = stein_direction(_normal(6, 3), score, lambda _: KernelTerms(gram, repulsion))
    expected = torch.einsum("ij,jd->id", gram, score) / 6 + repulsion / 6
    torch.testing.assert_close(found, expected)


def test_whitening_is_a_constant_matrix_valued_kernel():
    # Wang et al. 2019, Stein Variational Gradient Descent with Matrix-Valued Kernels, Sec. 3.2.
    factor = torch.linalg.cholesky(_gaussian(4).covariance_matrix)
    covariance, precision = factor @ factor.mT, torch.cholesky_inverse(factor)
    latent, score = _normal(5, 4), _normal(5, 4, seed=1)
    weights = latent @ factor.mT
    expected = torch.zeros(5, 4, dtype=torch.float64)
    for i in range(5):
        for j in range(5):
            offset = weights[j] - weights[i]
            kernel = torch.exp(-(offset @ precision @ offset) / 3.0)
            gradient = -2.0 / 3.0 * kernel * (precision @ offset)
            expected[i] += covariance @ (kernel * score[j] + gradient) / 5
    found = stein_direction(latent, score @ factor, RBF(3.0)) @ factor.mT
    torch.testing.assert_close(found, expected, atol=1e-12, rtol=1e-10)


def test_default_setting_finds_the_closed_form_posterior_of_a_primitive():
    basis = GaussianBasis(9)
    covariance = smooth_covariance(basis, 2, 0.3, 0.25)
    prior = ProMP.from_covariance(
        basis,
        torch.zeros(18, dtype=torch.float64),
        covariance + 1e-3 * torch.eye(18, dtype=torch.float64),
        torch.ones(2, dtype=torch.float64),
    )
    prior = prior.condition(0.0, torch.zeros(2, dtype=torch.float64))
    # A via-point half as wide as the prior: in directions that the likelihood makes much narrower,
    # a hundred particles lose their spread altogether.
    target = torch.tensor([0.4, -0.2], dtype=torch.float64)
    std = 0.15
    exact = prior.condition(0.6, target, torch.full((2,), std**2, dtype=torch.float64))
    at = torch.tensor([0.6], dtype=torch.float64)

    settings = replace(named_settings("svgd"), iterations=500)
    weights = prior.sample(100, torch.Generator().manual_seed(0))
    state = init(prior.whiten(weights), settings)
    for _ in range(settings.iterations):
        weights = prior.unwhiten(state.particles)
        residual = prior.trajectory(weights, at) - target
        gradient = prior.pull_back(-residual / std**2, at)
        state = step(state, -state.particles, prior.whiten_gradient(gradient), settings)
    weights = prior.unwhiten(state.particles)

    path = prior.trajectory(weights, 21)
    expected = exact.trajectory(exact.mean, 21)
    torch.testing.assert_close(path.mean(0), expected, atol=0.005, rtol=0)
    torch.testing.assert_close(path[:, 0], torch.zeros_like(path[:, 0]), atol=1e-12, rtol=0)
    for phase in (0.3, 0.6, 1.0):
        spread = prior.trajectory(weights, torch.tensor([phase]))[:, 0].std(0)
        truth = exact.marginal(phase)[1].diagonal().sqrt()
        torch.testing.assert_close(spread, truth, rtol=0.12, atol=0)


def test_score_annealing_scales_attraction_and_leaves_repulsion():
    particles, prior, likelihood = _normal(5, 3), _normal(5, 3, seed=1), _normal(5, 3, seed=2)
    settings = replace(PLAIN, annealing=0.7, iterations=10)
    temper = tanh_annealing(0, 10, 0.7)
    assert temper < 0.5
    gram, repulsion = RBF(median_bandwidth)(particles)
    expected = (
        particles + settings.step_size * (temper * gram @ (prior + likelihood) + repulsion) / 5
    )
    moved = step(init(particles, settings), prior, likelihood, settings).particles
    torch.testing.assert_close(moved, expected)

    settings = replace(settings, annealed="likelihood")
    expected = (
        particles + settings.step_size * (gram @ (prior + temper * likelihood) + repulsion) / 5
    )
    moved = step(init(particles, settings), prior, likelihood, settings).particles
    torch.testing.assert_close(moved, expected)


def test_steps_decay_to_the_stated_fraction():
    settings = replace(PLAIN, final_step=0.25, iterations=5)
    particles, score = _normal(4, 2), _normal(4, 2, seed=1)
    moved = [
        step(State(particles, None, i), score, torch.zeros_like(score), settings).particles
        for i in range(5)
    ]
    torch.testing.assert_close(moved[4] - particles, 0.25 * (moved[0] - particles))
    torch.testing.assert_close(moved[2] - particles, 0.625 * (moved[0] - particles))


def test_without_repulsion_the_direction_is_the_annealed_score():
    particles, prior, likelihood = _normal(5, 3), _normal(5, 3, seed=1), _normal(5, 3, seed=2)
    for annealed, factors in (("score", (1, 1)), ("likelihood", (0, 1))):
        settings = replace(PLAIN, annealing=0.7, annealed=annealed, repulsion=False, iterations=10)
        temper = tanh_annealing(0, 10, 0.7)
        direction = temper ** factors[0] * prior + temper ** factors[1] * likelihood
        moved = step(init(particles, settings), prior, likelihood, settings).particles
        torch.testing.assert_close(moved, particles + settings.step_size * direction)


def test_without_repulsion_every_particle_is_on_its_own():
    settings = replace(named_settings("no_repulsion"), iterations=300)
    target = _gaussian(3)
    particles = _normal(8, 3)
    together = _run(target, particles, settings)
    alone = _run(target, particles[2:3], settings)
    torch.testing.assert_close(together[2:3], alone)
    torch.testing.assert_close(together, target.mean.expand(8, 3), atol=0.02, rtol=0)


def test_leading_dimensions_are_independent_runs():
    particles, prior = _normal(3, 6, 2), _normal(3, 6, 2, seed=1)
    likelihood = _normal(3, 6, 2, seed=2)
    settings = SVGDSettings(iterations=4)
    batched = init(particles, settings)
    singles = [init(p, settings) for p in particles]
    for _ in range(4):
        batched = step(batched, prior, likelihood, settings)
        singles = [
            step(s, p, li, settings) for s, p, li in zip(singles, prior, likelihood, strict=True)
        ]
    torch.testing.assert_close(batched.particles, torch.stack([s.particles for s in singles]))


def test_a_step_changes_nothing_that_it_was_given():
    particles, score = _normal(5, 2), _normal(5, 2, seed=1)
    settings = SVGDSettings()
    state = init(particles.clone(), settings)
    first = step(state, score, score, settings)
    again = step(state, score, score, settings)
    assert torch.equal(state.particles, particles)
    assert torch.equal(first.particles, again.particles)
    assert (state.iteration, first.iteration) == (0, 1)


@pytest.mark.parametrize("name", SETTINGS)
def test_each_named_setting_improves_on_its_start(name):
    target = _gaussian(6)
    settings = named_settings(name)
    if settings.needs_metric:
        settings = settings.with_metric(0.5 * torch.eye(6, dtype=torch.float64))
    start = 3.0 + _normal(42, 6)
    particles = _run(target, start, settings)
    distance = (particles.mean(0) - target.mean).norm()
    assert float(distance) < 0.1 * float((start.mean(0) - target.mean).norm())


def test_single_precision_stays_single_precision():
    settings = SVGDSettings()
    score = torch.randn(5, 2, generator=torch.Generator().manual_seed(0))
    assert step(init(score, settings), score, score, settings).particles.dtype == torch.float32


def test_repulsion_fades_into_the_score_of_each_particle():
    """In the middle of a run the direction is half of Stein's, in the end none of it is."""
    particles = torch.randn(6, 3, generator=torch.Generator().manual_seed(0)).double()
    settings = SVGDSettings(
        optimizer=GradientAscent(), step_size=1.0, final_step=1.0, iterations=8, annealing=0.0
    )
    fading = replace(settings, fading=True)
    zeros = torch.zeros_like(particles)
    for iteration, share in ((0, 1.0), (4, 0.5), (6, 0.25)):
        moved = [
            step(State(particles, None, iteration), -particles, zeros, own).particles - particles
            for own in (fading, settings, replace(settings, repulsion=False))
        ]
        torch.testing.assert_close(moved[0], share * moved[1] + (1.0 - share) * moved[2])


def _changed(other, settings):
    return {k for k, v in vars(other).items() if v != vars(settings)[k]}


def test_the_named_settings_change_what_they_say():
    svgd, tempered = named_settings("svgd"), named_settings("tempered")
    competing = {"annealed", "schedule", "overdraw", "resampling", "moves"}
    changes = {
        "quick": {"optimizer", "step_size", "iterations"},
        "tempered": {"optimizer", "step_size", "iterations"} | competing,
        "no_repulsion": {"repulsion"},
        "raw": {"whiten"},
        "median_over_log": {"kernel"},
        "imq": {"kernel"},
        "path_kernel": {"kernel"},
        "no_annealing": {"annealing"},
        "cyclic": {"schedule"},
    }
    without = {
        "no_choice": "overdraw",
        "no_resampling": "resampling",
        "no_moves": "moves",
        "tempered_no_repulsion": "repulsion",
        "tempered_no_annealing": "annealing",
        "tempered_imq": "kernel",
        "fading": "fading",
    }
    assert set(SETTINGS) == {"svgd", "paper", *changes, *without}
    for name, changed in changes.items():
        assert _changed(named_settings(name), svgd) == changed
    for name, left_out in without.items():
        assert _changed(named_settings(name), tempered) == {left_out}


def test_the_schedule_scales_the_annealed_part():
    particles, score = _normal(5, 3), _normal(5, 3, seed=1)
    settings = replace(PLAIN, annealing=0.8, schedule=cyclic_annealing, iterations=10)
    gram, repulsion = RBF(median_bandwidth)(particles)
    for iteration in range(10):
        factor = cyclic_annealing(iteration, 10, 0.8)
        expected = particles + settings.step_size * (factor * gram @ score + repulsion) / 5
        state = State(particles, None, iteration)
        moved = step(state, score, torch.zeros_like(score), settings).particles
        torch.testing.assert_close(moved, expected)


# Bad input


def test_a_metric_is_for_a_metric_kernel():
    with pytest.raises(ValueError, match="kernel must be a MetricKernel to be given a metric"):
        named_settings("svgd").with_metric(torch.eye(3))
    unknown = named_settings("path_kernel")
    score = _normal(5, 2)
    with pytest.raises(ValueError, match="root of a MetricKernel must be given"):
        step(init(score, unknown), score, score, unknown)


def test_an_unknown_setting_lists_those_that_exist():
    with pytest.raises(ValueError, match=r"one of svgd, paper, quick, tempered, .*; got 'fast'"):
        named_settings("fast")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"step_size": 0.0}, "step_size must be positive"),
        ({"step_size": math.nan}, "step_size must be positive"),
        ({"iterations": 0}, "iterations must be at least 1, got 0"),
        ({"final_step": 1.5}, r"final_step must be in \[0, 1\], got 1\.5"),
        ({"annealing": -0.1}, r"annealing must be in \[0, 1\]"),
        ({"annealed": "prior"}, "annealed must be 'score' or 'likelihood', got 'prior'"),
    ],
)
def test_bad_settings_are_errors(change, message):
    with pytest.raises(ValueError, match=message):
        SVGDSettings(**change)


@pytest.mark.parametrize("shape", [(5,), (0, 3), (5, 0)])
def test_particles_of_a_bad_shape_are_errors(shape):
    with pytest.raises(ValueError, match=r"particles must have shape \(\.\.\., P, d\)"):
        init(torch.zeros(shape), SVGDSettings())


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_numbers_that_are_not_finite_are_errors(bad):
    good, settings = _normal(5, 2), SVGDSettings()
    broken = good.clone()
    broken[3, 1] = bad
    with pytest.raises(ValueError, match="particles must be finite"):
        init(broken, settings)
    with pytest.raises(ValueError, match="prior_score must be finite"):
        step(init(good, settings), broken, good, settings)
    with pytest.raises(ValueError, match="likelihood_score must be finite"):
        step(init(good, settings), good, broken, settings)


def test_a_score_of_another_shape_is_an_error():
    good, settings = _normal(5, 2), SVGDSettings()
    with pytest.raises(ValueError, match=r"likelihood_score must have the shape \(5, 2\)"):
        step(init(good, settings), good, good[:1], settings)


def test_more_steps_than_iterations_are_an_error():
    good, settings = _normal(5, 2), replace(PLAIN, iterations=1)
    state = step(init(good, settings), good, good, settings)
    with pytest.raises(ValueError, match=r"iteration must be in 0 \.\. 0, got 1"):
        step(state, good, good, settings)
