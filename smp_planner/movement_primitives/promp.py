"""Probabilistic movement primitives: a Gaussian over the weights of trajectories, Sec. III-A.

Weights are (K, D) and stand flattened row by row everywhere: entry k * D + d is the weight of basis
function k in dimension d. Velocities are derivatives with respect to phase.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from smp_gym.arrays import checked_number
from smp_planner.movement_primitives.basis import GaussianBasis, phases
from smp_planner.movement_primitives.covariances import (
    checked_covariance,
    checked_std,
    orthogonal_columns,
    rounding,
    smooth_covariance,
    square_root,
)
from smp_planner.movement_primitives.em import EMSettings, expectation_maximization, infer
from smp_planner.movement_primitives.samples import checked_demonstrations
from smp_planner.torch_threads import one_thread

__all__ = ["ProMP"]


@dataclass(frozen=True, eq=False)
class ProMP:
    """A Gaussian over trajectories, y_t = Φ_t w with w ~ N(μ_w, Σ_w), Eq. (1).

    Σ_w is kept as a square root R with Σ_w = R Rᵀ: exact conditioning takes columns away, and what
    was made certain stays certain to the last digit. `factor` is the square root L with orthogonal
    columns, through which weights are whitened, w = μ_w + L z with z ~ N(0, I).

    Several primitives that share Σ_w are one `ProMP` whose mean has leading dimensions, as arise
    from conditioning on several values at once. To work with (B, P, K*D) weights of P particles in
    each of B problems, condition on values (B, 1, D).

    Attributes:
        basis: K basis functions.
        mean: (..., K*D) μ_w.
        root: (K*D, m) R, any square root of Σ_w.
        noise: (D, D) covariance Σ_y of the observation noise; (D,) is taken as its diagonal.

    Raises:
        ValueError: shapes do not fit together, a number is not finite, or `noise` is not a
            positive definite covariance.
    """

    basis: GaussianBasis
    mean: Tensor
    root: Tensor
    noise: Tensor

    def __post_init__(self) -> None:
        if self.noise.ndim not in (1, 2):
            raise ValueError(f"noise must be (D,) or (D, D), got {tuple(self.noise.shape)}")
        dimension = self.noise.shape[-1]
        size = self.basis.count * dimension
        if self.mean.shape[-1:] != (size,):
            raise ValueError(
                f"mean must have shape (..., K * D = {self.basis.count} * {dimension}), "
                f"got {tuple(self.mean.shape)}"
            )
        if self.root.ndim != 2 or self.root.shape[0] != size:
            raise ValueError(f"root must be ({size}, m), got {tuple(self.root.shape)}")
        for name in ("mean", "root"):
            if not bool(torch.isfinite(getattr(self, name)).all()):
                raise ValueError(f"{name} must be finite, got NaN or infinity")
        noise = checked_covariance("noise", self.noise, dimension, self.mean)
        if not bool(torch.linalg.eigvalsh(noise)[0] > 0):
            raise ValueError(f"noise must be positive definite, got {noise}")
        object.__setattr__(self, "noise", noise)
        object.__setattr__(self, "root", self.root.to(self.mean))

    def __repr__(self) -> str:
        """Return a short description, without the arrays."""
        return f"ProMP({self.basis.count} basis functions, D = {self.dimension})"

    @classmethod
    def from_covariance(
        cls, basis: GaussianBasis, mean: Tensor, covariance: Tensor, noise: Tensor
    ) -> ProMP:
        """Return the primitive with Σ_w = `covariance`, (K*D, K*D), possibly singular.

        Raises:
            ValueError: `covariance` is not symmetric, or has a negative eigenvalue.
        """
        covariance = checked_covariance("covariance", covariance, mean.shape[-1], mean)
        return cls(basis, mean, square_root(covariance), noise)

    @classmethod
    @one_thread()
    def fit(
        cls,
        demonstrations: Tensor | np.ndarray | Sequence[Tensor | np.ndarray],
        basis: GaussianBasis | None = None,
        *,
        smooth_std: float | Sequence[float] = 0.2,
        smooth_length_scale: float = 0.2,
        em: EMSettings | None = None,
        nan_is_missing: bool = False,
    ) -> ProMP:
        """Learn a primitive from demonstrations.

        *Learned*, by expectation-maximisation: μ_w, Σ_w under an inverse-Wishart prior, and the
        observation noise Σ_y. *Added* to the learned Σ_w: `smooth_covariance`. A few demonstrations
        span a few directions only, and a multiple of the identity beside them lets a trajectory
        vibrate but not bend; the smooth part lets it bend around obstacles that were not there in
        the demonstrations.

        A dimension that is constant in all demonstrations is allowed: its mean is that constant,
        its noise the floor of `em`, and its covariance what is added.

        Args:
            demonstrations: (N, T, D), or N arrays (T_j, D), N at least 2, in rad or another unit;
                samples stand at equal steps of phase. Tensors keep their device and dtype (the
                learning itself is done in float64), arrays become float64.
            basis: default `GaussianBasis()`, K = 15.
            smooth_std: standard deviation that is added at mid phase, in the unit of the data: of
                every dimension, or of each (D,).
            smooth_length_scale: its length scale, in phase.
            em: priors and stopping rule of the learning.
            nan_is_missing: whether NaN in a demonstration stands for a number that was not
                measured: it is integrated out, and the samples beside it keep their phases.

        Raises:
            ValueError: fewer than two demonstrations, not all of one dimension, fewer than two
                samples in a dimension of one, or a number that is not finite and not missing.
        """
        basis = basis or GaussianBasis()
        smooth_length_scale = checked_number("smooth_length_scale", smooth_length_scale, above=0.0)
        checked = checked_demonstrations(demonstrations, nan_is_missing=nan_is_missing)
        exact = [d.double() for d in checked]
        std = checked_std("smooth_std", smooth_std, exact[0].shape[-1])
        learned = expectation_maximization(exact, basis, em)
        added = smooth_covariance(basis, exact[0].shape[-1], std, smooth_length_scale, exact[0])
        root = square_root(learned.covariance + added)
        mean, root, noise = (t.to(checked[0]) for t in (learned.mean, root, learned.noise))
        return cls(basis, mean, root, noise)

    @cached_property
    def factor(self) -> Tensor:
        """(K*D, r) L, its columns orthogonal, of falling length, and none zero within rounding."""
        # Worked out when it is asked for: chains of conditioning need it at their end alone.
        with one_thread():
            return orthogonal_columns(self.root)

    @property
    def dimension(self) -> int:
        """D, the number of coordinates of a trajectory."""
        return self.noise.shape[-1]

    @property
    def rank(self) -> int:
        """r, the number of free directions of the weights."""
        return self.factor.shape[-1]

    @property
    def covariance(self) -> Tensor:
        """(K*D, K*D) Σ_w."""
        return self.root @ self.root.mT

    def broaden(self, covariance: Tensor) -> ProMP:
        """Return the primitive with `covariance`, (K*D, K*D), added to Σ_w.

        Raises:
            ValueError: `covariance` is not a positive semi-definite matrix of that shape.
        """
        added = checked_covariance("covariance", covariance, self.mean.shape[-1], self.mean)
        return replace(self, root=torch.cat([self.root, square_root(added)], -1))

    def condition(
        self,
        phase: float,
        value: Tensor,
        covariance: Tensor | None = None,
        *,
        derivative: bool = False,
    ) -> ProMP:
        """Return the posterior after a position or a velocity was observed.

        Observation and noise are stacked into one linear map of standard normals, and the part of
        them that the observation leaves free is its null space. Nothing is inverted or subtracted,
        so an exact observation needs no jitter, and Σ_w stays positive semi-definite.

        Args:
            phase: where, in [0, 1].
            value: (..., D) observed position, or velocity with respect to phase; leading dimensions
                broadcast with those of the mean.
            covariance: (D, D), or (D,) for a diagonal, of the observation; zero or None is exact.
            derivative: whether `value` is a velocity.

        Returns:
            The posterior; an exact observation of something uncertain lowers the rank by D.

        Raises:
            ValueError: `phase` is outside [0, 1]; `value` is not finite or not (..., D);
                `covariance` is not a covariance; or an exact `value` contradicts what is already
                certain.
        """
        value = torch.as_tensor(value, dtype=self.mean.dtype, device=self.mean.device)
        if value.shape[-1:] != (self.dimension,):
            raise ValueError(
                f"value must have shape (..., {self.dimension}), got {tuple(value.shape)}"
            )
        if not bool(torch.isfinite(value).all()):
            raise ValueError(f"value must be finite, got {value}")
        return self._observe(self._rows(phase, derivative), value, covariance, f"phase {phase}")

    def observe(self, rows: Tensor, value: Tensor, covariance: Tensor | None = None) -> ProMP:
        """Return the posterior after a linear function of the weights was observed.

        Args:
            rows: (M, K*D), the function.
            value: (..., M) observed; leading dimensions broadcast with those of the mean.
            covariance: (M, M), or (M,) for a diagonal, of the observation; zero or None is exact.

        Returns:
            The posterior; see `condition`.

        Raises:
            ValueError: shapes do not fit; a number is not finite; `covariance` is not a covariance;
                or an exact `value` contradicts what is already certain.
        """
        rows = torch.as_tensor(rows, dtype=self.mean.dtype, device=self.mean.device)
        value = torch.as_tensor(value, dtype=self.mean.dtype, device=self.mean.device)
        if rows.ndim != 2 or rows.shape[1] != self.mean.shape[-1]:
            raise ValueError(
                f"rows must have shape (M, {self.mean.shape[-1]}), got {tuple(rows.shape)}"
            )
        if value.shape[-1:] != rows.shape[:1]:
            raise ValueError(f"value must have shape (..., {len(rows)}), got {tuple(value.shape)}")
        if not bool(torch.isfinite(value).all() and torch.isfinite(rows).all()):
            raise ValueError("rows and value must be finite, got NaN or infinity")
        return self._observe(rows, value, covariance, "these rows")

    def _observe(self, rows: Tensor, value: Tensor, covariance: Tensor | None, where: str) -> ProMP:
        if covariance is None:
            noise_factor = self.mean.new_zeros(len(rows), 0)
        else:
            checked = checked_covariance("covariance", covariance, len(rows), self.mean)
            noise_factor = square_root(checked)

        innovation = value - self.mean @ rows.mT
        stacked = torch.cat([rows @ self.root, noise_factor], -1)
        left, singular, right = torch.linalg.svd(stacked, full_matrices=True)
        scale = rows.norm() * self.root.norm() + noise_factor.norm()
        rank = int((singular > rounding(self.mean) * scale).sum())

        explained = innovation @ left[:, :rank]
        unexplained = innovation - explained @ left[:, :rank].mT
        allowed = math.sqrt(torch.finfo(self.mean.dtype).eps) * (1.0 + value.abs().max())
        if bool((unexplained.abs() > allowed).any()):
            raise ValueError(
                f"value {value} at {where} contradicts what is certain there: it is off by "
                f"{unexplained.abs().max().item():.3g}"
            )
        columns = self.root.shape[1]
        latent = (explained / singular[:rank]) @ right[:rank, :columns]
        free = right[rank:, :columns].mT
        return replace(self, mean=self.mean + latent @ self.root.mT, root=self.root @ free)

    def marginal(self, phase: float, *, derivative: bool = False) -> tuple[Tensor, Tensor]:
        """Return mean (..., D) and covariance (D, D) of the position or velocity at a phase.

        The observation noise is not included.
        """
        rows = self._rows(phase, derivative)
        half = rows @ self.root
        return self.mean @ rows.mT, half @ half.mT

    def sample(self, count: int, generator: torch.Generator) -> Tensor:
        """Draw weights.

        Args:
            count: n.
            generator: source of all randomness, on the device of the primitive.

        Returns:
            (n, ..., K*D), the dots being the leading dimensions of the mean.
        """
        shape = (count, *self.mean.shape[:-1], self.rank)
        latent = torch.randn(
            shape, generator=generator, dtype=self.mean.dtype, device=self.mean.device
        )
        return self.unwhiten(latent)

    def log_prob(self, weights: Tensor) -> Tensor:
        """Return the log-density of weights, (..., K*D) -> (...).

        If Σ_w is singular, this is the density on its support, of the nearest point of the support.
        """
        latent = self.whiten(weights)
        constant = 0.5 * self.rank * math.log(2.0 * math.pi)
        return -0.5 * latent.square().sum(-1) - self.log_volume - constant

    def score(self, weights: Tensor) -> Tensor:
        """Return the gradient of `log_prob`, (..., K*D) -> (..., K*D); it lies in the support."""
        return -(self.whiten(weights) / self._stds().square()) @ self.factor.mT

    def log_likelihood(
        self,
        demonstrations: Tensor | np.ndarray | Sequence[Tensor | np.ndarray],
        *,
        nan_is_missing: bool = False,
    ) -> Tensor:
        """Return the log-density of each demonstration, weights integrated out, Eq. (2).

        Args:
            demonstrations: (N, T, D), or N arrays (T_j, D).
            nan_is_missing: as `fit`; what is missing is integrated out, too.

        Returns:
            (N,).

        Raises:
            ValueError: as `fit`, or the mean of this primitive has leading dimensions.
        """
        if self.mean.ndim != 1:
            raise ValueError(f"mean must be one vector here, got {tuple(self.mean.shape)}")
        checked = checked_demonstrations(demonstrations, fewest=1, nan_is_missing=nan_is_missing)
        if checked[0].shape[-1] != self.dimension:
            raise ValueError(
                f"demonstrations must have dimension {self.dimension}, got {checked[0].shape[-1]}"
            )
        return torch.cat(
            [
                infer(
                    d[None].to(self.mean), self.basis, self.mean, self.factor, self.noise
                ).log_evidence
                for d in checked
            ]
        )

    @property
    def log_volume(self) -> float:
        """Logarithm of the product of the standard deviations of Σ_w on its support."""
        return float(self._stds().log().sum())

    def whiten(self, weights: Tensor) -> Tensor:
        """Return the standard normals z of weights μ_w + L z, (..., K*D) -> (..., r)."""
        return (weights - self.mean) @ (self.factor / self._stds().square())

    def unwhiten(self, latent: Tensor) -> Tensor:
        """Return the weights μ_w + L z, (..., r) -> (..., K*D)."""
        return self.mean + latent @ self.factor.mT

    def whiten_gradient(self, gradient: Tensor) -> Tensor:
        """Return the gradient by z of what has this gradient by w, (..., K*D) -> (..., r)."""
        return gradient @ self.factor

    def project(self, weights: Tensor) -> Tensor:
        """Return the nearest weights that are possible, (..., K*D) -> (..., K*D).

        They differ from those given only if Σ_w is singular, as after exact conditioning.
        """
        return self.unwhiten(self.whiten(weights))

    def trajectory(self, weights: Tensor, at: int | Tensor) -> Tensor:
        """Return the trajectories of weights.

        Args:
            weights: (..., K*D).
            at: number T of equally spaced phases from 0 to 1, or the phases, (T,).

        Returns:
            (..., T, D) positions.
        """
        return self.basis.values(self._phases(at)) @ self._matrix(weights)

    def velocity(self, weights: Tensor, at: int | Tensor) -> Tensor:
        """Return derivatives of the trajectories by phase; arguments and shape as `trajectory`."""
        return self.basis.derivatives(self._phases(at)) @ self._matrix(weights)

    def pull_back(self, gradient: Tensor, at: int | Tensor) -> Tensor:
        """Return the gradient by the weights of what has this gradient by the trajectory.

        Args:
            gradient: (..., T, D), with respect to positions.
            at: the phases of those positions, as in `trajectory`.

        Returns:
            (..., K*D).
        """
        return (self.basis.values(self._phases(at)).mT @ gradient).flatten(-2)

    def path_root(self, samples: int) -> Tensor:
        """Return R with |R (w - w')| the distance of two paths, root mean square over phase.

        Args:
            samples: T equally spaced phases.

        Returns:
            (min(T, K) * D, K*D); for whitened coordinates, `whiten_gradient` of it.
        """
        identity = torch.eye(self.dimension, dtype=self.mean.dtype, device=self.mean.device)
        return torch.kron(self.basis.path_root(samples).to(self.mean), identity)

    def _phases(self, at: int | Tensor) -> Tensor:
        if isinstance(at, Tensor):
            return at.to(self.mean)
        return phases(at, dtype=self.mean.dtype, device=self.mean.device)

    def _matrix(self, weights: Tensor) -> Tensor:
        if weights.shape[-1] != self.mean.shape[-1]:
            raise ValueError(
                f"weights must have shape (..., {self.mean.shape[-1]}), got {tuple(weights.shape)}"
            )
        return weights.unflatten(-1, (self.basis.count, self.dimension))

    def _rows(self, phase: float, derivative: bool) -> Tensor:
        """Return the (D, K*D) map from weights to position or velocity at a phase."""
        at = self.mean.new_tensor(phase)
        values = self.basis.derivatives(at) if derivative else self.basis.values(at)
        identity = torch.eye(self.dimension, dtype=self.mean.dtype, device=self.mean.device)
        return torch.kron(values[None], identity)

    def _stds(self) -> Tensor:
        """Return the lengths of the orthogonal columns of L, (r,)."""
        return torch.linalg.vector_norm(self.factor, dim=0)
