"""Primitives conditioned on what is to be passed, one for each choice of places."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from smp_planner.library.modulation import Place, Site
from smp_planner.movement_primitives import ProMP
from smp_planner.movement_primitives.mixture import shared_out

__all__ = ["Branch", "branches"]

FloatArray = NDArray[np.float64]

TOLERANCE_STDS = 3.0
"""Standard deviations of the conditioned primitive that a via-point's tolerance is."""

_CERTAIN = 1e-6
"""Extents, standard deviation that evidence is computed with where a primitive has none."""


@dataclass(frozen=True)
class Branch:
    """A primitive conditioned on one choice of places.

    Attributes:
        primitive: the posterior.
        count: how many of the particles are drawn from it.
    """

    primitive: ProMP
    count: int


def branches(primitive: ProMP, sites: Sequence[Site], particles: int) -> list[Branch]:
    """Return what a primitive becomes when it is conditioned on sites, in closed form.

    The posterior of a Gaussian and a mixture of places is a mixture: one branch for each choice,
    its share π_h times the density of the place under the primitive. Branches that would get no
    particle are left out. Sites with boxes are passed over.

    Args:
        primitive: the prior, in normalised coordinates.
        sites: ascending in phase.
        particles: to be shared out.
    """
    found = [(primitive, 0.0)]
    for site in sites:
        if not site.is_exact:
            continue
        grown = [
            (_conditioned(tied, site.phase, place), weight + _log_evidence(tied, site.phase, place))
            for tied, weight in found
            for place in site.places
        ]
        best = max(weight for _, weight in grown)
        found = [
            (tied, weight - best)
            for tied, weight in grown
            if weight - best > -math.log(2.0 * particles)
        ]
    counts = shared_out(particles, [math.exp(weight) for _, weight in found])
    return [
        Branch(tied, count) for (tied, _), count in zip(found, counts, strict=True) if count > 0
    ]


def _noise(primitive: ProMP, place: Place) -> torch.Tensor:
    std = place.tolerance / TOLERANCE_STDS
    return torch.full((primitive.dimension,), std**2, dtype=primitive.mean.dtype)


def _conditioned(primitive: ProMP, phase: float, place: Place) -> ProMP:
    assert place.point is not None
    return primitive.condition(phase, torch.from_numpy(place.point), _noise(primitive, place))


def _log_evidence(primitive: ProMP, phase: float, place: Place) -> float:
    assert place.point is not None
    mean, covariance = primitive.marginal(phase)
    noise = _noise(primitive, place) + _CERTAIN**2
    density = torch.distributions.MultivariateNormal(mean, covariance + torch.diag(noise))
    return math.log(place.share) + float(density.log_prob(torch.from_numpy(place.point)))
