"""Mixtures of primitives, for demonstrations that go more than one way: p(w) = Σ_c π_c N(μ_c, Σ_c).

Which demonstrations belong together is decided first, by their weights; then each group learns a
primitive of its own. With so few demonstrations, in so many dimensions, expectation-maximisation of
all components at once would find the same groups or a bad optimum.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from smp_planner.movement_primitives.basis import GaussianBasis, phases
from smp_planner.movement_primitives.promp import ProMP

__all__ = ["FEWEST", "SEPARATION", "ProMPMixture", "demonstrated_modes", "shared_out"]

SEPARATION = 2.4
"""Distance of the means of two groups, over the sum of their radii, from which they are modes. The
halves of one group lie nearer, at 1.3 if it is Gaussian along a line and at 1.7 if it is uniform;
of 7 or 14 draws from one Gaussian in three or more dimensions, less than 1 % look like modes."""

FEWEST = 3
"""Demonstrations that make a mode; fewer are odd ones of another."""

_SAMPLES = 200
"""Phases at which the distance of two paths is taken."""


def demonstrated_modes(
    demonstrations: Iterable[Tensor | NDArray[Any]], basis: GaussianBasis | None = None
) -> tuple[tuple[int, ...], ...]:
    """Return the groups that demonstrations fall into, as tuples of their indices.

    Each demonstration is given the weights that fit it best; the distance of two is that of their
    paths. A group is divided by 2-means, begun at the two members that are farthest apart, if the
    two halves lie `SEPARATION` times farther from each other than their radii (root mean square
    distance from the mean) amount to; then their halves are looked at. Fewer than `FEWEST`
    demonstrations are no mode.

    Args:
        demonstrations: N arrays (T_j, D).
        basis: default `GaussianBasis()`.
    """
    basis = basis or GaussianBasis()
    common = basis.values(phases(_SAMPLES))
    points = []
    for demonstration in demonstrations:
        path = torch.as_tensor(np.array(demonstration, np.float64))
        values = basis.values(phases(len(path), dtype=path.dtype))
        points.append((common @ torch.linalg.pinv(values) @ path).flatten().numpy())
    return _divided(np.stack(points), tuple(range(len(points))))


def _divided(weights: NDArray[np.float64], group: tuple[int, ...]) -> tuple[tuple[int, ...], ...]:
    halves = _two_means(weights[list(group)])
    if min(halves.sum(), (~halves).sum()) < FEWEST:
        return (group,)
    members = np.array(group)
    parts = [members[halves], members[~halves]]
    means = [weights[part].mean(axis=0) for part in parts]
    radii = [
        np.sqrt(np.square(weights[part] - mean).sum(axis=1).mean())
        for part, mean in zip(parts, means, strict=True)
    ]
    if np.linalg.norm(means[0] - means[1]) < SEPARATION * sum(radii):
        return (group,)
    # The group of the first demonstration stands first, whatever the halves are called.
    parts.sort(key=lambda part: int(part[0]))
    return tuple(mode for part in parts for mode in _divided(weights, tuple(part.tolist())))


def _two_means(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which of (N, d) points belong to the first of two means."""
    distances = np.linalg.norm(points[:, None] - points, axis=-1)
    first, second = np.unravel_index(distances.argmax(), distances.shape)
    means = points[[first, second]]
    halves = np.zeros(len(points), np.bool_)
    for _ in range(len(points)):
        nearer = np.linalg.norm(points[:, None] - means, axis=-1)
        halves = nearer[:, 0] <= nearer[:, 1]
        if halves.all() or not halves.any():
            break
        means = np.stack([points[halves].mean(axis=0), points[~halves].mean(axis=0)])
    return halves


def shared_out(count: int, shares: Sequence[float] | NDArray[np.float64]) -> list[int]:
    """Return how many of `count` each share gets, by the method of the largest remainder."""
    exact = np.asarray(shares, np.float64) / np.sum(shares) * count
    given = np.floor(exact + 1e-9).astype(int)
    order = np.argsort(-(exact - given), kind="stable")
    given[order[: count - given.sum()]] += 1
    return [int(n) for n in given]


@dataclass(frozen=True, eq=False)
class ProMPMixture:
    """A mixture of primitives, p(w) = Σ_c π_c N(w; μ_c, Σ_c).

    Attributes:
        components: C primitives over the same basis.
        shares: (C,) π_c, positive; they are scaled to sum to one.

    Raises:
        ValueError: no component, components of different size, or `shares` are not C positive
            numbers.
    """

    components: tuple[ProMP, ...]
    shares: Tensor

    def __post_init__(self) -> None:
        if not self.components:
            raise ValueError("components must hold at least one primitive, got none")
        sizes = {component.mean.shape for component in self.components}
        if len(sizes) > 1:
            raise ValueError(f"components must have one size, got means of shapes {sorted(sizes)}")
        shares = torch.as_tensor(self.shares).to(self.components[0].mean)
        if shares.shape != (len(self.components),) or not bool(
            (torch.isfinite(shares) & (shares > 0)).all()
        ):
            raise ValueError(
                f"shares must be {len(self.components)} positive numbers, got {self.shares}"
            )
        object.__setattr__(self, "shares", shares / shares.sum())

    @classmethod
    def fit(
        cls,
        demonstrations: Sequence[Tensor | NDArray[Any]],
        basis: GaussianBasis | None = None,
        **settings: Any,
    ) -> ProMPMixture:
        """Learn a component from each of the `demonstrated_modes`, π_c = N_c / N.

        Args:
            demonstrations: N arrays (T_j, D), see `ProMP.fit`.
            basis: default `GaussianBasis()`.
            **settings: of `ProMP.fit`.
        """
        modes = demonstrated_modes(demonstrations, basis)
        components = tuple(
            ProMP.fit([demonstrations[i] for i in mode], basis, **settings) for mode in modes
        )
        return cls(components, torch.tensor([len(mode) for mode in modes], dtype=torch.float64))

    def sample(self, count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Draw weights.

        Args:
            count: n.
            generator: source of all randomness.

        Returns:
            (n, K*D) weights, and (n,) the component that each was drawn from.
        """
        which = torch.multinomial(self.shares, count, replacement=True, generator=generator)
        drawn = torch.stack([c.sample(count, generator) for c in self.components])
        return drawn[which, torch.arange(count)], which

    def log_prob(self, weights: Tensor) -> Tensor:
        """Return the log-density of weights, (..., K*D) -> (...)."""
        return torch.logsumexp(self._joint(weights), dim=-1)

    def responsibilities(self, weights: Tensor) -> Tensor:
        """Return the probability of each component given weights, (..., K*D) -> (..., C)."""
        return torch.softmax(self._joint(weights), dim=-1)

    def score(self, weights: Tensor) -> Tensor:
        """Return the gradient of `log_prob`, (..., K*D) -> (..., K*D)."""
        scores = torch.stack([component.score(weights) for component in self.components], dim=-1)
        return (scores * self.responsibilities(weights)[..., None, :]).sum(-1)

    def _joint(self, weights: Tensor) -> Tensor:
        densities = [component.log_prob(weights) for component in self.components]
        return torch.stack(densities, dim=-1) + self.shares.log()
