"""Mixtures of primitives, for demonstrations of several modes: p(w) = Σ_c π_c N(μ_c, Σ_c).

Which demonstrations belong together is decided first, by their weights; then each group learns a
primitive of its own. With so few demonstrations, in so many dimensions, expectation-maximisation of
all components at once would find the same groups or a bad optimum.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from smp_planner.movement_primitives.basis import GaussianBasis
from smp_planner.movement_primitives.em import fitted_weights
from smp_planner.movement_primitives.promp import ProMP
from smp_planner.movement_primitives.samples import checked_demonstrations
from smp_planner.torch_threads import one_thread

__all__ = ["LEAST_MODE_SIZE", "SEPARATION", "ProMPMixture", "demonstrated_modes", "shared_out"]

SEPARATION = 2.4
"""Distance of the means of two groups, over the sum of their radii, from which they are modes. The
halves of one group lie nearer, at 1.3 if it is Gaussian along a line and at 1.7 if it is uniform;
of 7 or 14 draws from one Gaussian in three or more dimensions, less than 1 % pass for modes."""

LEAST_MODE_SIZE = 3
"""Least number of demonstrations in a mode; fewer are outliers of another."""

_COMPARED_PHASES = 200
"""Phases over which the distance of two paths is averaged."""


def demonstrated_modes(
    demonstrations: Iterable[Tensor | NDArray[Any]],
    basis: GaussianBasis | None = None,
    *,
    modes: int | None = None,
    nan_is_missing: bool = False,
) -> tuple[tuple[int, ...], ...]:
    """Return the groups that demonstrations fall into, as tuples of their indices.

    Each demonstration is given the weights that fit it best; the distance of two is that of their
    paths, root mean square over phase. A group is divided by 2-means, begun at the two members
    that are farthest apart, if the two halves lie `SEPARATION` times farther from each other than
    the sum of their radii (root mean square distances from the mean); then their halves are
    tried. Fewer than `LEAST_MODE_SIZE` demonstrations are no mode.

    If it is known how many there are, the group whose division takes the most from the sum of
    squares is divided, until there are so many.

    Args:
        demonstrations: N arrays (T_j, D).
        basis: default `GaussianBasis()`.
        modes: how many groups, 1 .. N / 2; None finds it out.
        nan_is_missing: see `ProMP.fit`.

    Raises:
        ValueError: a demonstration is not (T, D) or not finite, `modes` is out of range, or the
            demonstrations cannot be divided into so many groups of at least two.
    """
    basis = basis or GaussianBasis()
    checked = checked_demonstrations(demonstrations, fewest=1, nan_is_missing=nan_is_missing)
    everything, most = tuple(range(len(checked))), max(1, len(checked) // 2)
    if modes is not None and not 1 <= modes <= most:
        raise ValueError(
            f"modes must be 1 .. {most}, as a primitive is learned from two demonstrations at "
            f"least and there are {len(checked)}; got {modes}"
        )
    root = basis.path_root(_COMPARED_PHASES)
    weights = [fitted_weights(d.detach().cpu().double()[None], basis)[0] for d in checked]
    points = torch.stack([(root @ w.unflatten(0, (basis.count, -1))).flatten() for w in weights])
    if modes is None:
        return _divided(points.numpy(), everything)
    groups = [everything]
    while len(groups) < modes:
        groups = _with_one_more(points.numpy(), groups)
    return tuple(groups)


def _divided(points: NDArray[np.float64], group: tuple[int, ...]) -> tuple[tuple[int, ...], ...]:
    parts = _halves(points, group)
    if min(map(len, parts)) < LEAST_MODE_SIZE:
        return (group,)
    means = [points[list(part)].mean(axis=0) for part in parts]
    radii = [math.sqrt(_sum_of_squares(points, part) / len(part)) for part in parts]
    if np.linalg.norm(means[0] - means[1]) < SEPARATION * sum(radii):
        return (group,)
    return tuple(mode for part in parts for mode in _divided(points, part))


def _with_one_more(
    points: NDArray[np.float64], groups: list[tuple[int, ...]]
) -> list[tuple[int, ...]]:
    """Return the groups with the one divided for which it takes the most from its squares."""
    gains = []
    for index, group in enumerate(groups):
        parts = _halves(points, group)
        if min(map(len, parts)) >= 2:
            kept = sum(_sum_of_squares(points, part) for part in parts)
            gains.append((_sum_of_squares(points, group) - kept, index, parts))
    if not gains:
        sizes = ", ".join(str(len(group)) for group in groups)
        raise ValueError(
            f"modes must be at most {len(groups)} for these demonstrations: groups of {sizes} "
            "cannot be divided further into parts of at least two"
        )
    _, index, parts = max(gains, key=lambda gain: gain[0])
    return groups[:index] + list(parts) + groups[index + 1 :]


def _sum_of_squares(points: NDArray[np.float64], group: tuple[int, ...]) -> float:
    """Return the sum of the squared distances of a group's points from their mean."""
    members = points[list(group)]
    return float(np.square(members - members.mean(axis=0)).sum())


def _halves(
    points: NDArray[np.float64], group: tuple[int, ...]
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the two parts of a group by 2-means, first the one with its first member."""
    first = _two_means(points[list(group)])
    first = first if first[0] else ~first
    members = np.array(group)
    return tuple(members[first].tolist()), tuple(members[~first].tolist())


def _two_means(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return a mask of the points (N, d) that belong to the first of two means."""
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
    """Return `count` apportioned to shares, by the method of the largest remainder."""
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

    def __repr__(self) -> str:
        """Return a short description, without the arrays."""
        shares = ", ".join(f"{share:.3g}" for share in self.shares.tolist())
        return f"ProMPMixture({len(self.components)} of {self.components[0]!r}, shares {shares})"

    @classmethod
    @one_thread()
    def fit(
        cls,
        demonstrations: Sequence[Tensor | NDArray[Any]],
        basis: GaussianBasis | None = None,
        *,
        modes: int | None = None,
        nan_is_missing: bool = False,
        **settings: Any,
    ) -> ProMPMixture:
        """Learn a component from each of the `demonstrated_modes`, π_c = N_c / N.

        Args:
            demonstrations: N arrays (T_j, D), see `ProMP.fit`.
            basis: default `GaussianBasis()`.
            modes: how many components, 1 .. N / 2; None finds it out.
            nan_is_missing: see `ProMP.fit`.
            **settings: of `ProMP.fit`.

        Raises:
            ValueError: as `demonstrated_modes` and `ProMP.fit`.
        """
        groups = demonstrated_modes(
            demonstrations, basis, modes=modes, nan_is_missing=nan_is_missing
        )
        components = tuple(
            ProMP.fit(
                [demonstrations[i] for i in group],
                basis,
                nan_is_missing=nan_is_missing,
                **settings,
            )
            for group in groups
        )
        return cls(components, torch.tensor([len(group) for group in groups]).double())

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
