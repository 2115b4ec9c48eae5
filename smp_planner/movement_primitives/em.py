"""Expectation-maximisation for the hierarchical model of Eq. (1) and (2).

Each demonstration has weights of its own, w ~ N(μ_w, Σ_w), and is observed through the basis with
noise, y_t = Φ_t w + v, v ~ N(0, Σ_y). Weights are flattened row by row from (K, D).
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from smp_planner.movement_primitives.basis import GaussianBasis, phases

__all__ = ["EMSettings", "LearnedDistribution", "Posterior", "expectation_maximization", "infer"]

_LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True)
class EMSettings:
    """What the learning assumes before it sees a demonstration; lengths in the data's unit.

    The prior of Σ_w is inverse-Wishart and stated by its effect on the maximum a posteriori: it
    counts as `prior_count` further demonstrations whose weights have covariance `prior_std`² I. In
    the usual symbols its scale is `prior_count` `prior_std`² I and its degrees of freedom are
    `prior_count` - KD - 1. (A proper prior needs more than KD - 1 of them; with that many, seven
    demonstrations would hardly be heard, so the improper limit is taken.)

    Attributes:
        prior_std: standard deviation of a weight under the prior of Σ_w, rad. Divided among N + 1
            it is about 0.01 for seven demonstrations: nothing beside the freedom that is added
            later, but the condition number of Σ_w, on which methods that work on raw weights
            depend, falls with its square.
        prior_count: weight of that prior, in demonstrations.
        noise_std_floor: smallest standard deviation of the observation noise, rad. It keeps Σ_y
            invertible when a dimension is constant or the basis fits exactly.
        max_iterations: iterations at most.
        tolerance: stop when the penalised log-likelihood per observed number rises by less.

    Raises:
        ValueError: a number is not positive.
    """

    prior_std: float = 0.03
    prior_count: float = 1.0
    noise_std_floor: float = 1e-4
    max_iterations: int = 200
    tolerance: float = 1e-6

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"EMSettings.{name} must be positive and finite, got {value}")


class Posterior(NamedTuple):
    """Posterior of the weights of n equally long demonstrations.

    Attributes:
        mean: (n, K*D) posterior means.
        covariance: (K*D, K*D), common to all: it depends on the phases only.
        residual: (n, T, D) demonstrations minus the trajectories of the posterior means.
        log_evidence: (n,) log-density of each demonstration with its weights integrated out,
            Eq. (2).
    """

    mean: Tensor
    covariance: Tensor
    residual: Tensor
    log_evidence: Tensor


class LearnedDistribution(NamedTuple):
    """What expectation-maximisation found.

    Attributes:
        mean: (K*D,) μ_w.
        covariance: (K*D, K*D) Σ_w.
        noise: (D, D) Σ_y.
        objective: penalised log-likelihood before each iteration; it never falls.
    """

    mean: Tensor
    covariance: Tensor
    noise: Tensor
    objective: tuple[float, ...]


def infer(
    demonstrations: Tensor, basis: GaussianBasis, mean: Tensor, factor: Tensor, noise: Tensor
) -> Posterior:
    """Return the posterior of the weights given equally long demonstrations (the E-step).

    Computed for the standard normal z of w = μ_w + L z, so Σ_w = L Lᵀ is never inverted.

    Args:
        demonstrations: (n, T, D).
        basis: K basis functions.
        mean: (K*D,) μ_w.
        factor: (K*D, r) L.
        noise: (D, D) Σ_y, positive definite.
    """
    _, samples, dimension = demonstrations.shape
    values = basis.values(phases(samples, dtype=mean.dtype, device=mean.device))
    noise_factor = torch.linalg.cholesky(noise)
    noise_precision = torch.cholesky_inverse(noise_factor).contiguous()
    information = torch.kron(values.mT @ values, noise_precision)
    identity = torch.eye(factor.shape[-1], dtype=mean.dtype, device=mean.device)
    precision_factor = torch.linalg.cholesky(identity + factor.mT @ information @ factor)

    centred = demonstrations - values @ mean.unflatten(-1, (-1, dimension))
    evidence = (values.mT @ centred @ noise_precision).flatten(-2)
    latent = torch.cholesky_solve((evidence @ factor).mT, precision_factor).mT
    shift = latent @ factor.mT
    half = torch.linalg.solve_triangular(precision_factor, factor.mT, upper=False)

    residual = centred - values @ shift.unflatten(-1, (-1, dimension))
    misfit = ((residual @ noise_precision) * residual).sum((-2, -1)) + latent.square().sum(-1)
    log_determinant = 2.0 * (
        samples * noise_factor.diagonal().log().sum() + precision_factor.diagonal().log().sum()
    )
    constant = samples * dimension * math.log(2.0 * math.pi)
    return Posterior(
        mean=mean + shift,
        covariance=half.mT @ half,
        residual=residual,
        log_evidence=-0.5 * (misfit + log_determinant + constant),
    )


def expectation_maximization(
    demonstrations: Sequence[Tensor],
    basis: GaussianBasis,
    settings: EMSettings | None = None,
) -> LearnedDistribution:
    """Learn μ_w, Σ_w and Σ_y from demonstrations (Sec. III-A; Σ_w with an inverse-Wishart prior).

    Args:
        demonstrations: N tensors (T_j, D), T_j at least 2, of one dtype and device; sample t of a
            demonstration stands at phase t / (T_j - 1).
        basis: K basis functions.
        settings: priors and stopping rule.

    Returns:
        The maximum a posteriori of Σ_w, and maximum likelihood of μ_w and of Σ_y subject to its
        floor.
    """
    settings = settings or EMSettings()
    groups = [
        torch.stack([d for d in demonstrations if len(d) == length])
        for length in sorted({len(d) for d in demonstrations})
    ]
    mean, covariance, noise = _initial(groups, basis, settings)
    objective: list[float] = []
    observed = sum(group.numel() for group in groups)
    for _ in range(settings.max_iterations):
        factor = torch.linalg.cholesky(covariance)
        posteriors = [infer(group, basis, mean, factor, noise) for group in groups]
        objective.append(_objective(posteriors, factor, settings))
        mean, covariance, noise = _maximize(posteriors, basis, settings)
        if len(objective) > 1 and objective[-1] - objective[-2] < settings.tolerance * observed:
            break
    else:
        _LOGGER.info("EM stopped at %d iterations before it converged", settings.max_iterations)
    return LearnedDistribution(mean, covariance, noise, tuple(objective))


def _initial(
    groups: list[Tensor], basis: GaussianBasis, settings: EMSettings
) -> tuple[Tensor, Tensor, Tensor]:
    """Return μ_w, Σ_w and Σ_y from a least-squares fit to each demonstration on its own."""
    posteriors = []
    for group in groups:
        dimension = group.shape[-1]
        values = basis.values(phases(group.shape[1], dtype=group.dtype, device=group.device))
        weights = torch.linalg.pinv(values) @ group
        size = basis.count * dimension
        posteriors.append(
            Posterior(
                mean=weights.flatten(-2),
                covariance=group.new_zeros(size, size),
                residual=group - values @ weights,
                log_evidence=group.new_zeros(len(group)),
            )
        )
    return _maximize(posteriors, basis, settings)


def _maximize(
    posteriors: list[Posterior], basis: GaussianBasis, settings: EMSettings
) -> tuple[Tensor, Tensor, Tensor]:
    """Return μ_w, Σ_w and Σ_y that maximise the expected penalised log-likelihood (the M-step)."""
    means = torch.cat([p.mean for p in posteriors])
    mean = means.mean(0)
    deviation = means - mean
    identity = torch.eye(len(mean), dtype=mean.dtype, device=mean.device)
    scatter = deviation.mT @ deviation + settings.prior_count * settings.prior_std**2 * identity
    scatter = scatter + sum(len(p.mean) * p.covariance for p in posteriors)
    covariance = scatter / (len(means) + settings.prior_count)

    dimension = posteriors[0].residual.shape[-1]
    noise = mean.new_zeros(dimension, dimension)
    samples = 0
    for p in posteriors:
        count, length, _ = p.residual.shape
        values = basis.values(phases(length, dtype=mean.dtype, device=mean.device))
        blocks = p.covariance.unflatten(0, (-1, dimension)).unflatten(-1, (-1, dimension))
        spread = torch.einsum("kalb,kl->ab", blocks, values.mT @ values)
        noise = noise + torch.einsum("nta,ntb->ab", p.residual, p.residual) + count * spread
        samples += count * length
    # Raising the eigenvalues to the floor is the exact maximum under that constraint, so the
    # objective still never falls.
    eigenvalues, eigenvectors = torch.linalg.eigh(noise / samples)
    eigenvalues = eigenvalues.clamp_min(settings.noise_std_floor**2)
    return mean, covariance, (eigenvectors * eigenvalues) @ eigenvectors.mT


def _objective(posteriors: list[Posterior], factor: Tensor, settings: EMSettings) -> float:
    """Return the log-likelihood of the demonstrations plus the log-prior of Σ_w = L Lᵀ."""
    likelihood = sum(float(p.log_evidence.sum()) for p in posteriors)
    log_determinant = 2.0 * float(factor.diagonal().log().sum())
    trace = settings.prior_std**2 * float(torch.cholesky_inverse(factor).diagonal().sum())
    return likelihood - 0.5 * settings.prior_count * (log_determinant + trace)
