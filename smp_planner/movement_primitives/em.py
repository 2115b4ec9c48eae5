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
from smp_planner.movement_primitives.covariances import smooth_covariance, square_root
from smp_planner.movement_primitives.samples import equal_stacks

__all__ = [
    "EMSettings",
    "LearnedDistribution",
    "Posterior",
    "expectation_maximization",
    "fitted_weights",
    "infer",
]

_FILL_LENGTH_SCALE, _FILL_NOISE = 0.2, 0.01
"""Of the prior that bridges missing samples: length scale in phase, and standard deviation of the
noise over the extent of the demonstrations."""

_LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True)
class EMSettings:
    """Prior of the learning over its parameters; lengths in the data's unit.

    The prior of Σ_w is inverse-Wishart and stated by its effect on the maximum a posteriori: it
    counts as `prior_count` further demonstrations whose weights have covariance `prior_std`² I. In
    the usual symbols its scale is `prior_count` `prior_std`² I and its degrees of freedom are
    `prior_count` - KD - 1. (A proper prior needs more than KD - 1 of them; with that many, seven
    demonstrations would hardly have an effect, so the improper limit is taken.)

    Attributes:
        prior_std: standard deviation of a weight under the prior of Σ_w, rad. Divided among N + 1
            it is about 0.01 for seven demonstrations: nothing beside the covariance that is added
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


class _Pattern(NamedTuple):
    """The samples of a demonstration at which the same dimensions are present.

    Given the noise at those, what the noise is at the others has a mean and a covariance.

    Attributes:
        values: (t, K) basis functions at those samples.
        rows: (t,) which samples.
        precision: (D, D) inverse of Σ_y between the dimensions present, zero elsewhere.
        imputation: (D, D) from the noise, of which only the dimensions present are used, to
            the mean of it all; the identity if all are present.
        remainder: (D, D) covariance of it all given the dimensions present.
        log_determinant: of the square root of Σ_y between the dimensions present.
    """

    values: Tensor
    rows: Tensor
    precision: Tensor
    imputation: Tensor
    remainder: Tensor
    log_determinant: Tensor


class Posterior(NamedTuple):
    """Posterior of the weights of n demonstrations that are equally long and miss the same samples.

    Attributes:
        mean: (n, K*D) posterior means.
        covariance: (K*D, K*D), common to all: it depends on the phases only.
        scatter: (D, D) expected outer products of the noise, summed over all samples that are not
            missing altogether.
        samples: how many those are.
        log_evidence: (n,) log-density of each demonstration with its weights integrated out,
            Eq. (2).
    """

    mean: Tensor
    covariance: Tensor
    scatter: Tensor
    samples: int
    log_evidence: Tensor


class LearnedDistribution(NamedTuple):
    """Result of expectation-maximisation.

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


def _patterns(demonstration: Tensor, basis: GaussianBasis, noise: Tensor) -> list[_Pattern]:
    """Return the samples (T, D) by which dimensions are present, without those that have none."""
    values = basis.values(phases(len(demonstration), dtype=noise.dtype, device=noise.device))
    kinds, which = torch.unique(~torch.isnan(demonstration), dim=0, return_inverse=True)
    patterns = []
    for index, kind in enumerate(kinds):
        if not bool(kind.any()):
            continue
        rows = (which == index).nonzero().flatten()
        present, missing = kind.nonzero().flatten(), (~kind).nonzero().flatten()
        factor = torch.linalg.cholesky(noise[present[:, None], present])
        inverse = torch.cholesky_inverse(factor)
        between = noise[missing[:, None], present]
        gain = between @ inverse
        precision, imputation, remainder = (torch.zeros_like(noise) for _ in range(3))
        precision[present[:, None], present] = inverse
        imputation[present, present] = 1.0
        imputation[missing[:, None], present] = gain
        remainder[missing[:, None], missing] = noise[missing[:, None], missing] - gain @ between.mT
        log_determinant = factor.diagonal().log().sum()
        patterns.append(
            _Pattern(values[rows], rows, precision, imputation, remainder, log_determinant)
        )
    return patterns


def infer(
    demonstrations: Tensor, basis: GaussianBasis, mean: Tensor, factor: Tensor, noise: Tensor
) -> Posterior:
    """Return the posterior of the weights given demonstrations of one stack (the E-step).

    Computed for the standard normal z of w = μ_w + L z, so Σ_w = L Lᵀ is never inverted. Where some
    dimensions of a sample are missing, those present count through their own block of Σ_y, which is
    what integrating the missing ones out amounts to.

    Args:
        demonstrations: (n, T, D), NaN at the same places in all where samples are missing.
        basis: K basis functions.
        mean: (K*D,) μ_w.
        factor: (K*D, r) L.
        noise: (D, D) Σ_y, positive definite.
    """
    count, _, dimension = demonstrations.shape
    patterns = _patterns(demonstrations[0], basis, noise)
    information = sum(torch.kron(p.values.mT @ p.values, p.precision) for p in patterns)
    identity = torch.eye(factor.shape[-1], dtype=mean.dtype, device=mean.device)
    precision_factor = torch.linalg.cholesky(identity + factor.mT @ information @ factor)

    offset = mean.unflatten(-1, (-1, dimension))
    centred = [demonstrations[:, p.rows].nan_to_num() - p.values @ offset for p in patterns]
    evidence = sum(
        (p.values.mT @ c @ p.precision).flatten(-2) for p, c in zip(patterns, centred, strict=True)
    )
    latent = torch.cholesky_solve((evidence @ factor).mT, precision_factor).mT
    shift = latent @ factor.mT
    half = torch.linalg.solve_triangular(precision_factor, factor.mT, upper=False)
    covariance = half.mT @ half

    blocks = covariance.unflatten(0, (-1, dimension)).unflatten(-1, (-1, dimension))
    misfit = latent.square().sum(-1)
    scatter, log_determinant = torch.zeros_like(noise), precision_factor.diagonal().log().sum()
    for p, c in zip(patterns, centred, strict=True):
        residual = c - p.values @ shift.unflatten(-1, (-1, dimension))
        misfit = ((residual @ p.precision) * residual).sum((-2, -1)) + misfit
        log_determinant = len(p.rows) * p.log_determinant + log_determinant
        imputed = residual @ p.imputation.mT
        spread = torch.einsum("kalb,kl->ab", blocks, p.values.mT @ p.values)
        spread = p.imputation @ spread @ p.imputation.mT + len(p.rows) * p.remainder
        scatter = scatter + torch.einsum("nta,ntb->ab", imputed, imputed) + count * spread
    observed = int((~torch.isnan(demonstrations[0])).sum())
    return Posterior(
        mean=mean + shift,
        covariance=covariance,
        scatter=scatter,
        samples=count * sum(len(p.rows) for p in patterns),
        log_evidence=-0.5 * (misfit + 2.0 * log_determinant + observed * math.log(2.0 * math.pi)),
    )


def fitted_weights(demonstrations: Tensor, basis: GaussianBasis) -> Tensor:
    """Return the weights that fit each of the demonstrations of one stack.

    They are the least-squares fit; where samples are missing, which leaves weights free, the
    posterior mean under a wide prior that is smooth along the phase.

    Args:
        demonstrations: (n, T, D), NaN at the same places in all where samples are missing.
        basis: K basis functions.

    Returns:
        (n, K*D).
    """
    _, samples, dimension = demonstrations.shape
    if not bool(torch.isnan(demonstrations).any()):
        values = basis.values(
            phases(samples, dtype=demonstrations.dtype, device=demonstrations.device)
        )
        return (torch.linalg.pinv(values) @ demonstrations).flatten(-2)
    center = demonstrations.flatten(0, -2).nanmean(0)
    extent = float((demonstrations - center).nan_to_num().abs().max()) or 1.0
    smooth = smooth_covariance(basis, dimension, extent, _FILL_LENGTH_SCALE, demonstrations)
    noise = (_FILL_NOISE * extent) ** 2 * torch.eye(dimension).to(demonstrations)
    mean = center.expand(basis.count, dimension).flatten()
    return infer(demonstrations, basis, mean, square_root(smooth), noise).mean


def expectation_maximization(
    demonstrations: Sequence[Tensor],
    basis: GaussianBasis,
    settings: EMSettings | None = None,
) -> LearnedDistribution:
    """Learn μ_w, Σ_w and Σ_y from demonstrations (Sec. III-A; Σ_w with an inverse-Wishart prior).

    Args:
        demonstrations: N tensors (T_j, D), T_j at least 2, of one dtype and device; sample t of a
            demonstration stands at phase t / (T_j - 1). NaN stands for what is missing.
        basis: K basis functions.
        settings: priors and stopping rule.

    Returns:
        The maximum a posteriori of Σ_w, and maximum likelihood of μ_w and of Σ_y subject to its
        floor.
    """
    settings = settings or EMSettings()
    groups = equal_stacks(demonstrations)
    mean, covariance, noise = _initial(groups, basis, settings)
    objective: list[float] = []
    observed = sum(int((~torch.isnan(group)).sum()) for group in groups)
    for _ in range(settings.max_iterations):
        factor = torch.linalg.cholesky(covariance)
        posteriors = [infer(group, basis, mean, factor, noise) for group in groups]
        objective.append(_objective(posteriors, factor, settings))
        mean, covariance, noise = _maximize(posteriors, settings)
        if len(objective) > 1 and objective[-1] - objective[-2] < settings.tolerance * observed:
            break
    else:
        _LOGGER.info("EM stopped at %d iterations before it converged", settings.max_iterations)
    return LearnedDistribution(mean, covariance, noise, tuple(objective))


def _initial(
    groups: list[Tensor], basis: GaussianBasis, settings: EMSettings
) -> tuple[Tensor, Tensor, Tensor]:
    """Return μ_w, Σ_w and Σ_y from a fit to each demonstration on its own."""
    posteriors = []
    for group in groups:
        count, length, dimension = group.shape
        values = basis.values(phases(length, dtype=group.dtype, device=group.device))
        weights = fitted_weights(group, basis)
        residual = (group - values @ weights.unflatten(-1, (-1, dimension))).nan_to_num()
        size = basis.count * dimension
        posteriors.append(
            Posterior(
                mean=weights,
                covariance=group.new_zeros(size, size),
                scatter=torch.einsum("nta,ntb->ab", residual, residual),
                samples=count * length,
                log_evidence=group.new_zeros(count),
            )
        )
    return _maximize(posteriors, settings)


def _maximize(posteriors: list[Posterior], settings: EMSettings) -> tuple[Tensor, Tensor, Tensor]:
    """Return μ_w, Σ_w and Σ_y that maximise the expected penalised log-likelihood (the M-step)."""
    means = torch.cat([p.mean for p in posteriors])
    mean = means.mean(0)
    deviation = means - mean
    identity = torch.eye(len(mean), dtype=mean.dtype, device=mean.device)
    scatter = deviation.mT @ deviation + settings.prior_count * settings.prior_std**2 * identity
    scatter = scatter + sum(len(p.mean) * p.covariance for p in posteriors)
    covariance = scatter / (len(means) + settings.prior_count)

    noise = torch.stack([p.scatter for p in posteriors]).sum(0)
    # Raising the eigenvalues to the floor is the exact maximum under that constraint, so the
    # objective still never falls.
    eigenvalues, eigenvectors = torch.linalg.eigh(noise / sum(p.samples for p in posteriors))
    eigenvalues = eigenvalues.clamp_min(settings.noise_std_floor**2)
    return mean, covariance, (eigenvectors * eigenvalues) @ eigenvectors.mT


def _objective(posteriors: list[Posterior], factor: Tensor, settings: EMSettings) -> float:
    """Return the log-likelihood of the demonstrations plus the log-prior of Σ_w = L Lᵀ."""
    likelihood = sum(float(p.log_evidence.sum()) for p in posteriors)
    log_determinant = 2.0 * float(factor.diagonal().log().sum())
    trace = settings.prior_std**2 * float(torch.cholesky_inverse(factor).diagonal().sum())
    return likelihood - 0.5 * settings.prior_count * (log_determinant + trace)
