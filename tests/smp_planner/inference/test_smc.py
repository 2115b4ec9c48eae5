"""Sequential Monte Carlo against posteriors in closed form."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from smp_planner.inference.smc import SMCSettings, sample_posterior

FloatArray = NDArray[np.float64]


def _gaussian(z: FloatArray, center: FloatArray, std: FloatArray) -> FloatArray:
    return -0.5 * np.square((z - center) / std).sum(-1)


def test_gaussian_posterior() -> None:
    """A Gaussian observation of 30 standard normals, some of them sharply observed."""
    dimension = 30
    center = np.linspace(-2.0, 2.0, dimension)
    std = np.where(np.arange(dimension) % 3 == 0, 0.2, 5.0)
    posterior = sample_posterior(
        lambda z: _gaussian(z, center, std),
        dimension,
        np.random.default_rng(0),
        SMCSettings(particles=1000, last_moves=400),
    )
    variance = 1.0 / (1.0 + std**-2)
    z = (posterior.particles - variance * center / std**2) / np.sqrt(variance)
    assert np.abs(z.mean(0)).max() < 0.25
    assert np.abs(z.std(0) - 1.0).max() < 0.2
    evidence = multivariate_normal(np.zeros(dimension), np.diag(1.0 + std**2)).logpdf(center)
    evidence += 0.5 * np.log(2.0 * np.pi * std**2).sum()
    assert posterior.log_evidence == pytest.approx(evidence, abs=0.5)
    assert posterior.temperatures[-1] == 1.0
    assert (np.diff(posterior.temperatures) > 0.0).all()


def test_mixture_keeps_its_weights() -> None:
    """Two modes of unequal weight between which no move can go."""
    dimension, std = 10, 0.15
    shares = np.array([0.8, 0.2])
    centers = np.zeros((2, dimension))
    centers[:, 0] = [-1.5, 1.0]

    def log_likelihood(z: FloatArray) -> FloatArray:
        first = np.square((z[:, :1] - centers[:, 0]) / std)
        return np.asarray(logsumexp(np.log(shares) - 0.5 * first, axis=1))

    # Each mode's evidence is its share times the prior's density, smoothed by std, at its centre.
    wanted = shares * np.exp(-0.5 * centers[:, 0] ** 2 / (1.0 + std**2))
    wanted /= wanted.sum()
    weights = []
    for seed in range(5):
        drawn = sample_posterior(
            log_likelihood, dimension, np.random.default_rng(seed), SMCSettings(1000, last_moves=20)
        ).particles
        weights.append((drawn[:, 0] < 0.0).mean())
    assert np.mean(weights) == pytest.approx(wanted[0], abs=0.04)
    assert np.std(weights) < 0.06
    second = drawn[drawn[:, 0] > 0.0]
    assert second[:, 0].mean() == pytest.approx(1.0 / (1.0 + std**2), abs=0.05)
    assert np.abs(drawn[:, 1:].std(0) - 1.0).max() < 0.15


def test_same_generator_same_draws() -> None:
    first, second = (
        sample_posterior(lambda z: -(z[:, 0] ** 2), 2, np.random.default_rng(3), SMCSettings(50))
        for _ in range(2)
    )
    assert np.array_equal(first.particles, second.particles)


def test_a_flat_likelihood_leaves_the_prior() -> None:
    posterior = sample_posterior(lambda z: np.zeros(len(z)), 3, np.random.default_rng(0))
    assert posterior.log_evidence == pytest.approx(0.0, abs=1e-12)
    assert posterior.temperatures.tolist() == [1.0]
    assert np.abs(posterior.particles.std(0) - 1.0).max() < 0.1


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"particles": 1}, "particles must be at least 2, got 1"),
        ({"effective": 1.0}, r"effective must be in \(0, 1\), got 1.0"),
        ({"moves": 0}, "moves must be at least 1, got 0"),
        ({"last_moves": 0}, "last_moves must be at least 1, got 0"),
    ],
)
def test_settings_out_of_range(settings: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SMCSettings(**settings)  # type: ignore[arg-type]


def test_bad_arguments() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="dimension must be at least 1, got 0"):
        sample_posterior(lambda z: z[:, 0], 0, rng)
    with pytest.raises(ValueError, match="finite numbers"):
        sample_posterior(lambda z: z[:, 0] * np.nan, 2, rng)
    with pytest.raises(ValueError, match=r"got shape \(2000, 2\)"):
        sample_posterior(lambda z: z, 2, rng)
