"""What particles make of known targets with each kernel, in 2 to 90 dimensions."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from smp_planner.inference import (
    RBF,
    InverseMultiquadric,
    MetricKernel,
    SVGDSettings,
    init,
    median_over_log_bandwidth,
    step,
)

PATIENT = SVGDSettings(step_size=0.1, final_step=0.01, iterations=250)
DIMENSIONS = {2: 100, 10: 150, 30: 100, 90: 100}
"""d, and particles in that many dimensions."""


def _normal(*shape: int, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, generator=generator, dtype=torch.float64)


def _root(dimension: int, seed: int) -> torch.Tensor:
    return torch.eye(dimension).double() + 0.5 * _normal(dimension, dimension, seed=seed) / (
        dimension**0.5
    )


def _kernel(name: str, dimension: int):
    return {
        "rbf": RBF(),
        "rbf over log": RBF(median_over_log_bandwidth),
        "imq": InverseMultiquadric(),
        "imq over log": InverseMultiquadric(median_over_log_bandwidth),
        "metric rbf": MetricKernel(_root(dimension, 8)),
        "metric imq": MetricKernel(_root(dimension, 8), InverseMultiquadric()),
    }[name]


def _run(score, particles: torch.Tensor, settings: SVGDSettings) -> torch.Tensor:
    state = init(particles, settings)
    for _ in range(settings.iterations):
        gradient = score(state.particles)
        state = step(state, gradient, torch.zeros_like(gradient), settings)
    return state.particles


LEAST_SHARES = {
    "rbf": (0.95, 0.90, 0.84, 0.60),
    "rbf over log": (0.90, 0.50, 0.18, 0.06),
    "imq": (0.96, 0.92, 0.83, 0.62),
    "imq over log": (0.94, 0.81, 0.60, 0.34),
    "metric rbf": (0.96, 0.90, 0.77, 0.52),
    "metric imq": (0.96, 0.92, 0.77, 0.54),
}
"""Of the target's total variance that the particles have at least, for each of `DIMENSIONS`. Known:
a finite set under-estimates it, and the more the higher the dimension; the smaller bandwidth leaves
next to nothing. With no kernel is it over-estimated by more than a hundredth."""


@pytest.mark.parametrize("dimension", DIMENSIONS)
@pytest.mark.parametrize("name", LEAST_SHARES)
def test_mean_and_variance_of_a_gaussian(name, dimension):
    root = _root(dimension, 5)
    mean, covariance = torch.linspace(-1, 1, dimension).double(), root @ root.mT
    precision = torch.linalg.inv(covariance)
    particles = _run(
        lambda x: -(x - mean) @ precision,
        _normal(DIMENSIONS[dimension], dimension),
        replace(PATIENT, kernel=_kernel(name, dimension)),
    )
    torch.testing.assert_close(particles.mean(0), mean, atol=0.015, rtol=0)
    share = float(particles.var(0, correction=0).sum() / covariance.trace())
    least = LEAST_SHARES[name][list(DIMENSIONS).index(dimension)]
    assert least < share < 1.01
    if dimension == 2:
        found = torch.cov(particles.mT, correction=0)
        torch.testing.assert_close(found, covariance, atol=0.1 * float(covariance.max()), rtol=0)


WEIGHTS, CENTERS, VARIANCE = (0.35, 0.65), (-1.2, 1.2), 0.36


def _two_modes(particles: torch.Tensor) -> torch.Tensor:
    """Return the score of two modes along the first axis, standard normal along all others."""
    centers = torch.zeros(2, particles.shape[-1]).double()
    centers[:, 0] = torch.tensor(CENTERS)
    variance = torch.ones(particles.shape[-1]).double()
    variance[0] = VARIANCE
    offset = particles[:, None] - centers
    exponent = -0.5 * (offset.square() / variance).sum(-1)
    share = torch.softmax(exponent + torch.tensor(WEIGHTS).double().log(), -1)
    return -(share[..., None] * offset / variance).sum(1)


@pytest.mark.parametrize("dimension", [2, 10, 90])
@pytest.mark.parametrize("name", ["rbf", "imq", "metric rbf", "metric imq"])
def test_both_modes_of_a_mixture_are_covered(name, dimension):
    start = _normal(100, dimension)
    start[:, 0] *= 2.0
    settings = replace(PATIENT, kernel=_kernel(name, dimension))
    particles = _run(_two_modes, start, settings)
    grid = np.linspace(-6, 6, 4001)
    density = sum(
        w * np.exp(-((grid - c) ** 2) / (2 * VARIANCE))
        for w, c in zip(WEIGHTS, CENTERS, strict=True)
    )
    right = particles[:, 0] > 0
    # Known: hardly a particle changes modes, so that the shares remember the start, half and half.
    exact = density[grid > 0].sum() / density.sum()
    assert float(right.double().mean()) == pytest.approx(exact, abs=0.2)
    for side, of_grid in ((right, grid > 0), (~right, grid < 0)):
        mean = np.average(grid[of_grid], weights=density[of_grid])
        # Known: a kernel as wide as the whole set drives the modes apart, here by an eighth.
        assert float(particles[side, 0].mean()) == pytest.approx(mean, abs=0.3)
    others = particles[:, 1:].mean(0)
    torch.testing.assert_close(others, torch.zeros_like(others), atol=0.02, rtol=0)
