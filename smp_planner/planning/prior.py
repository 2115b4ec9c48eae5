"""The prior of a planner: primitives learned from demonstrations, with added smooth covariance."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray

from smp_planner.movement_primitives import (
    GaussianBasis,
    ProMP,
    ProMPMixture,
    demonstrated_modes,
    smooth_covariance,
)
from smp_planner.planning.settings import PriorSettings
from smp_planner.torch_threads import one_thread

__all__ = ["Prior", "learn_prior"]

_KEPT_WIDTHS = 8
"""Widths whose components are kept: those of the settings, and of a few tries with wider ones."""


@dataclass(frozen=True, eq=False)
class Prior:
    """Primitives learned from demonstrations.

    Attributes:
        single: one Gaussian for all demonstrations.
        mixture: a component for each of the demonstrations' modes; `single` alone if there is but
            one.
        settings: how it was learned.
    """

    single: ProMP
    mixture: ProMPMixture
    settings: PriorSettings
    _wider: dict[float, list[ProMP]] = field(default_factory=dict, init=False, repr=False)

    def __repr__(self) -> str:
        """Return a short description, without the arrays."""
        return f"Prior({len(self.mixture.components)} components, {self.single!r})"

    @cached_property
    def digest(self) -> str:
        """Digest of what was learned, which tells priors apart."""
        content = self.single.mean.numpy().tobytes() + self.single.factor.numpy().tobytes()
        return hashlib.blake2b(content, digest_size=8).hexdigest()

    @property
    def used(self) -> ProMPMixture:
        """The mixture that is planned with, see `PriorSettings.per_component`."""
        if self.settings.per_component:
            return self.mixture
        return ProMPMixture((self.single,), torch.ones(1))

    def components(self, width: float = 1.0) -> list[ProMP]:
        """Return the components of `used`, with `width` (at least 1) times the added deviation."""
        if width not in self._wider:
            found = [self.widened(component, width) for component in self.used.components]
            while len(self._wider) >= _KEPT_WIDTHS:
                self._wider.pop(next(iter(self._wider)), None)
            self._wider[width] = found
        return list(self._wider[width])

    def widened(self, primitive: ProMP, width: float) -> ProMP:
        """Return a primitive of it with `width` (at least 1) times the added deviation."""
        if width <= 1.0:
            return primitive
        added = np.multiply(self.settings.smooth_std, np.sqrt(width**2 - 1.0))
        length_scale = self.settings.smooth_length_scale
        return primitive.broaden(
            smooth_covariance(primitive.basis, primitive.dimension, added, length_scale)
        )


@one_thread()
def learn_prior(demonstrations: Sequence[NDArray[np.float64]], settings: PriorSettings) -> Prior:
    """Return the prior that demonstrations teach.

    Args:
        demonstrations: N arrays (T_j, D), N at least 2, at equal steps of phase; rad, m or extents.
        settings: how to learn.

    Raises:
        ValueError: as `ProMP.fit` and `demonstrated_modes`.
    """
    basis = GaussianBasis(settings.basis_functions)

    def learn(group: Sequence[NDArray[np.float64]]) -> ProMP:
        return ProMP.fit(
            group,
            basis,
            smooth_std=settings.smooth_std,
            smooth_length_scale=settings.smooth_length_scale,
            nan_is_missing=settings.nan_is_missing,
        )

    groups = demonstrated_modes(
        demonstrations, basis, modes=settings.modes, nan_is_missing=settings.nan_is_missing
    )
    single = learn(demonstrations)
    components = tuple(
        single if len(groups) == 1 else learn([demonstrations[i] for i in group])
        for group in groups
    )
    shares = torch.tensor([float(len(group)) for group in groups])
    return Prior(single, ProMPMixture(components, shares), settings)
