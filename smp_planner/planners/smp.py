"""`smp`: Stein Movement Primitives, the paper's Algorithm 1."""

from __future__ import annotations

from smp_planner.adaptation import Stein
from smp_planner.planners.adapting import AdaptingPlanner, AdaptingSettings

__all__ = ["SMPPlanner", "SMPSettings"]


class SMPSettings(Stein, AdaptingSettings):
    """Settings of Stein Movement Primitives."""


class SMPPlanner(AdaptingPlanner):
    """A particle set from the conditioned primitive, carried to the posterior by SVGD.

    With a mixture as prior, each component has its share of the particles, whitened by its own
    factor, and is a run of its own against the same likelihood. Components are so far apart, in
    units of their own spread, that the kernel and the responsibilities between them vanish: one run
    with all particles would do the same, but for a bandwidth that spans both.
    """

    name = "smp"
    Settings = SMPSettings
