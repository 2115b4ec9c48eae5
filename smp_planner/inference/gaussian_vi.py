"""Gaussian variational inference as two pure functions, `init_gaussian` and `step_gaussian`.

A Gaussian q = N(m, L Lᵀ) is moved towards p(x|O) ∝ exp(-C(x)) N(x; 0, I) by descending
E_q[C(x)] + KL(q || N(0, I)), Eq. (10), whose expectation is taken by reparameterisation: with
x = m + L ε and ε ~ N(0, I) its gradient is E[∇C(x)] by m and the lower triangle of E[∇C(x) εᵀ] by L
(Kingma & Welling 2014, Sec. 2.4; Titsias & Lázaro-Gredilla 2014). The divergence is in closed form.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import torch
from torch import Tensor

from smp_planner.inference.annealing import check_steps, linear_decay
from smp_planner.inference.optimizers import Adam, Optimizer

__all__ = ["GaussianState", "GaussianVISettings", "init_gaussian", "step_gaussian"]


@dataclass(frozen=True)
class GaussianVISettings:
    """Settings of Gaussian variational inference.

    Attributes:
        optimizer: turns the direction of descent into a change.
        step_size: of the first iteration.
        final_step: step size of the last iteration, as a fraction of the first.
        iterations: of a whole run.

    Raises:
        ValueError: a number is out of range.
    """

    optimizer: Optimizer = field(default_factory=Adam)
    step_size: float = 0.1
    final_step: float = 0.1
    iterations: int = 100

    def __post_init__(self) -> None:
        check_steps(self.step_size, self.final_step, self.iterations)


class GaussianState(NamedTuple):
    """State of Gaussian variational inference between two iterations.

    Attributes:
        mean: (d,) m.
        lower: (d, d) strictly lower triangle of L.
        log_diagonal: (d,) logarithms of its diagonal, so that it stays positive.
        memory: what the optimiser remembers.
        iteration: how many iterations are done.
    """

    mean: Tensor
    lower: Tensor
    log_diagonal: Tensor
    memory: Any
    iteration: int

    @property
    def factor(self) -> Tensor:
        """(d, d) L."""
        return self.lower + torch.diag(self.log_diagonal.exp())

    def particles(self, noise: Tensor) -> Tensor:
        """Return x = m + L ε, (..., d) -> (..., d)."""
        return self.mean + noise @ self.factor.mT


def init_gaussian(dimension: int, settings: GaussianVISettings) -> GaussianState:
    """Return the state before the first iteration: the prior N(0, I).

    Args:
        dimension: d, at least 1.
        settings: of the run.

    Raises:
        ValueError: `dimension` is less than 1.
    """
    if dimension < 1:
        raise ValueError(f"dimension must be at least 1, got {dimension}")
    zeros = torch.zeros(dimension, dtype=torch.float64)
    square = torch.zeros(dimension, dimension, dtype=torch.float64)
    memory = settings.optimizer.init(_stacked(zeros, square, zeros))
    return GaussianState(zeros, square, zeros, memory, 0)


def step_gaussian(
    state: GaussianState, noise: Tensor, gradient: Tensor, settings: GaussianVISettings
) -> GaussianState:
    """Return the state after one more iteration.

    Args:
        state: before it.
        noise: (P, d) ε, drawn anew for each iteration.
        gradient: (P, d) gradient of C at `state.particles(noise)`.
        settings: the same as for `init_gaussian`.

    Raises:
        ValueError: `noise` is not (P, d), `gradient` has another shape or is not finite, or all
            iterations are done.
    """
    if noise.ndim != 2 or noise.shape[1] != len(state.mean):
        raise ValueError(f"noise must have shape (P, {len(state.mean)}), got {tuple(noise.shape)}")
    if gradient.shape != noise.shape:
        raise ValueError(
            f"gradient must have the shape {tuple(noise.shape)} of the noise, "
            f"got {tuple(gradient.shape)}"
        )
    if not math.isfinite(gradient.sum().item()):
        raise ValueError("gradient must be finite, got NaN or infinity")
    decay = linear_decay(state.iteration, settings.iterations, settings.final_step)
    diagonal = state.log_diagonal.exp()
    by_factor = gradient.mT @ noise / len(noise)
    # KL = (|m|² + |L|² - d) / 2 - Σ log L_ii, with L_ii = exp(l_i) for the chain rule.
    by_mean = gradient.mean(0) + state.mean
    by_lower = (by_factor + state.lower).tril(-1)
    by_diagonal = diagonal * by_factor.diagonal() + diagonal.square() - 1.0
    change, memory = settings.optimizer.update(
        -_stacked(by_mean, by_lower, by_diagonal), state.memory, state.iteration
    )
    mean, lower, log_diagonal = (settings.step_size * decay * c for c in _unstacked(change))
    return GaussianState(
        state.mean + mean,
        state.lower + lower,
        state.log_diagonal + log_diagonal,
        memory,
        state.iteration + 1,
    )


def _stacked(mean: Tensor, lower: Tensor, log_diagonal: Tensor) -> Tensor:
    """Return all parameters as one tensor (d + 2, d), for the optimiser."""
    return torch.cat([mean[None], log_diagonal[None], lower])


def _unstacked(parameters: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    return parameters[0], parameters[2:], parameters[1]
