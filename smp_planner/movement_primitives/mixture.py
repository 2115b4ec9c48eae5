"""Mixtures of primitives, for demonstrations of several modes: p(w) = Σ_c π_c N(μ_c, Σ_c).

Which demonstrations belong together is decided first, by their weights; then each group learns a
primitive of its own. With so few demonstrations, in so many dimensions, expectation-maximisation of
all components at once would find the same groups or a bad optimum.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.cluster.vq import ClusterError, kmeans2
from torch import Tensor

from smp_planner.movement_primitives.basis import GaussianBasis
from smp_planner.movement_primitives.em import fitted_weights
from smp_planner.movement_primitives.promp import ProMP
from smp_planner.movement_primitives.samples import checked_demonstrations
from smp_planner.torch_threads import one_thread

__all__ = [
    "SEPARATION",
    "SEPARATION_OF_PAIRS",
    "ProMPMixture",
    "demonstrated_modes",
    "shared_out",
]

SEPARATION = 2.4
"""Distance of the means of two groups, over the sum of their radii, from which they are modes. Of 7
or 14 draws from one Gaussian in two or more dimensions, less than 1 % pass for modes."""

SEPARATION_OF_PAIRS = 4.0
"""The same where one of the groups has two members, whose radius chance may make small."""

_EQUAL = 1e-6
"""Radius of a pair, over its distance from another group, up to which the two are copies."""

_FINEST = 40
"""Groups into which demonstrations are divided at most; those of one member are no mode."""

_STARTS = 30
"""Of k-means."""

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
    paths, root mean square over phase. Ward's clustering joins them, two groups at a time, so that
    the sum of squares grows least, and so proposes a division into every number of groups. A
    demonstration that is left alone belongs to the nearest group. Taken is the finest division of
    which any two groups lie `SEPARATION` times farther apart than the sum of their radii: the root
    mean square distances from the mean, with the size less one for a divisor.

    If it is known how many there are, k-means divides them. A warning says where these are fewer
    than are found: a Gaussian of two patterns has draws that are like neither.

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
    most = max(1, len(checked) // 2)
    if modes is not None and not 1 <= modes <= most:
        raise ValueError(
            f"modes must be 1 .. {most}, as a primitive is learned from two demonstrations at "
            f"least and there are {len(checked)}; got {modes}"
        )
    root = basis.path_root(_COMPARED_PHASES)
    weights = [fitted_weights(d.detach().cpu().double()[None], basis)[0] for d in checked]
    points = torch.stack([(root @ w.unflatten(0, (basis.count, -1))).flatten() for w in weights])
    divisions = _divisions(points.numpy())
    found = next(each for each in divisions if _separated(points.numpy(), each))
    if modes is None:
        return found
    if modes < len(found):
        warnings.warn(
            f"demonstrations fall into {len(found)} groups, of "
            f"{', '.join(str(len(group)) for group in found)}; with modes={modes} one primitive is "
            "learned of several of them, and its draws may be like none",
            stacklevel=2,
        )
    if modes == 1:
        return (tuple(range(len(checked))),)
    return _k_means(points.numpy(), modes)


def _k_means(points: NDArray[np.float64], count: int) -> tuple[tuple[int, ...], ...]:
    """Return points (N, d) in so many groups of at least two, of the least sum of squares found."""
    best: tuple[tuple[int, ...], ...] | None = None
    least = math.inf
    for seed in range(_STARTS):
        try:
            # Equal points have no chance to be chosen, of all of them each 0 / 0.
            with np.errstate(invalid="ignore"):
                means, labels = kmeans2(
                    points, count, iter=100, minit="++", rng=seed, missing="raise"
                )
        except ClusterError:
            continue  # A group has lost all members.
        groups = [tuple(np.flatnonzero(labels == label).tolist()) for label in range(count)]
        squares = float(np.square(points - means[labels]).sum())
        if squares < least and min(map(len, groups)) >= 2:
            best, least = tuple(sorted(groups)), squares
    if best is None:
        raise ValueError(
            f"modes must be less for these {len(points)} demonstrations, which do not fall into "
            f"groups of at least two; got {count}"
        )
    return best


def _divisions(points: NDArray[np.float64]) -> list[tuple[tuple[int, ...], ...]]:
    """Return divisions of points (N, d) into groups of at least two, the finest first."""
    everything = (tuple(range(len(points))),)
    if len(points) < 2:
        return [everything]
    tree = linkage(points, "ward")
    finest = min(len(points), _FINEST)
    found = [_groups(points, fcluster(tree, count, "maxclust")) for count in range(finest, 1, -1)]
    ordered = sorted((each for each in found if each), key=len, reverse=True)
    return [*ordered, everything]


def _groups(points: NDArray[np.float64], labels: NDArray[np.int32]) -> tuple[tuple[int, ...], ...]:
    """Return the members of each label, those that are alone with the nearest group."""
    members = [np.flatnonzero(labels == label) for label in np.unique(labels)]
    groups = [group.tolist() for group in members if len(group) > 1]
    if not groups:
        return ()
    means = np.stack([points[group].mean(axis=0) for group in groups])
    for group in members:
        if len(group) == 1:
            nearest = int(np.linalg.norm(means - points[group], axis=1).argmin())
            groups[nearest] += group.tolist()
    return tuple(sorted(tuple(sorted(group)) for group in groups))


def _separated(points: NDArray[np.float64], groups: Sequence[tuple[int, ...]]) -> bool:
    """Return whether any two groups lie as far apart as modes do."""
    own = [points[list(group)] for group in groups]
    means = [group.mean(axis=0) for group in own]
    radii = [
        math.sqrt(np.square(group - mean).sum() / max(len(group) - 1, 1))
        for group, mean in zip(own, means, strict=True)
    ]
    for i, j in combinations(range(len(groups)), 2):
        apart = float(np.linalg.norm(means[i] - means[j]))
        pairs = [radii[k] for k in (i, j) if len(groups[k]) < 3]
        # Two that are equal are one, copied: they say nothing of how far one's like may be.
        if pairs and min(pairs) <= _EQUAL * apart:
            return False
        if not apart > (SEPARATION_OF_PAIRS if pairs else SEPARATION) * (radii[i] + radii[j]):
            return False
    return True


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
