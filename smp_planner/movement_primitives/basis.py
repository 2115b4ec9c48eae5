"""Normalised Gaussian basis functions of the phase, Φ_t of Eq. (1)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from smp_gym.arrays import checked_count

__all__ = ["GaussianBasis", "phases"]


def phases(
    count: int, *, dtype: torch.dtype = torch.float64, device: torch.device | None = None
) -> Tensor:
    """Return `count` equally spaced phases from 0 to 1, both included.

    Args:
        count: at least 2.
        dtype: floating type of the result.
        device: torch device of the result; None is torch's default.

    Returns:
        (count,) phases.

    Raises:
        ValueError: `count` is less than 2.
    """
    if count < 2:
        raise ValueError(f"count of phases must be at least 2, got {count}")
    return torch.linspace(0.0, 1.0, count, dtype=dtype, device=device)


@dataclass(frozen=True)
class GaussianBasis:
    """K Gaussian bumps along the phase, normalised to sum to one everywhere.

    The centres are equally spaced and reach beyond [0, 1] on both sides, so that the ends of a
    trajectory are as free as its middle. The width (standard deviation) of a bump is the spacing.

    Attributes:
        count: K; the default is the paper's (Sec. V-B).
        outside: how many centres lie beyond each end of [0, 1].

    Raises:
        ValueError: `outside` is negative, or fewer than two centres are left inside.
    """

    count: int = 15
    outside: int = 1

    def __post_init__(self) -> None:
        outside = checked_count("outside", self.outside, least=0)
        object.__setattr__(self, "outside", outside)
        object.__setattr__(self, "count", checked_count("count", self.count, least=2 * outside + 2))

    @property
    def width(self) -> float:
        """Standard deviation of a bump and distance between centres, in phase."""
        return 1.0 / (self.count - 1 - 2 * self.outside)

    def centers(self, like: Tensor | None = None) -> Tensor:
        """Return the centres, (K,), with dtype and device of `like` (default: float64 on CPU)."""
        dtype = torch.float64 if like is None else like.dtype
        device = None if like is None else like.device
        margin = self.outside * self.width
        return torch.linspace(-margin, 1.0 + margin, self.count, dtype=dtype, device=device)

    def values(self, phase: Tensor) -> Tensor:
        """Return the basis functions.

        Args:
            phase: (...), each in [0, 1].

        Returns:
            (..., K), non-negative, summing to 1 over K.

        Raises:
            ValueError: a phase is outside [0, 1] or not a number.
        """
        return self._values_and_slopes(phase)[0]

    def derivatives(self, phase: Tensor) -> Tensor:
        """Return the derivatives of the basis functions with respect to phase.

        Args:
            phase: (...), each in [0, 1].

        Returns:
            (..., K), summing to 0 over K.

        Raises:
            ValueError: a phase is outside [0, 1] or not a number.
        """
        values, slopes = self._values_and_slopes(phase)
        return values * (slopes - (values * slopes).sum(-1, keepdim=True))

    def path_root(self, samples: int) -> Tensor:
        """Return R with |R w|² = (1/T) Σ_t (Φ_t w)², the mean square of the path of weights w.

        Args:
            samples: T equally spaced phases, at least 2.

        Returns:
            (min(T, K), K).
        """
        values = self.values(phases(samples))
        return torch.linalg.qr(values / math.sqrt(samples)).R.contiguous()

    def _values_and_slopes(self, phase: Tensor) -> tuple[Tensor, Tensor]:
        """Return the normalised bumps and the derivatives of the logarithms of the plain bumps."""
        phase = torch.as_tensor(phase)
        if not phase.is_floating_point():
            phase = phase.double()
        inside = (phase >= 0.0) & (phase <= 1.0)
        if not bool(inside.all()):
            raise ValueError(f"phase must be in [0, 1], got {phase[~inside].flatten()[0].item()}")
        offset = (phase.unsqueeze(-1) - self.centers(phase)) / self.width
        return torch.softmax(-0.5 * offset.square(), -1), -offset / self.width
