"""Primitives conditioned on what is to be passed, one for each choice of places."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from smp_planner.library.site import Site
from smp_planner.movement_primitives import ProMP
from smp_planner.movement_primitives.mixture import shared_out

__all__ = ["Branch", "branches"]


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
    particle are left out.

    Args:
        primitive: the prior, in normalised coordinates.
        sites: ascending in phase.
        particles: to be shared out.
    """
    found = [(primitive, 0.0)]
    for site in sites:
        grown = [
            (conditioned, weight + evidence)
            for tied, weight in found
            for conditioned, evidence in site.condition(tied)
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
