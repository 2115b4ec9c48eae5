"""Probabilistic movement primitives: basis, distributions over weights, box prior."""

from smp_planner.movement_primitives.basis import GaussianBasis, phases
from smp_planner.movement_primitives.blending import blend
from smp_planner.movement_primitives.box_prior import SmoothBox
from smp_planner.movement_primitives.covariances import smooth_covariance
from smp_planner.movement_primitives.em import EMSettings
from smp_planner.movement_primitives.mixture import ProMPMixture, demonstrated_modes
from smp_planner.movement_primitives.promp import ProMP

__all__ = [
    "EMSettings",
    "GaussianBasis",
    "ProMP",
    "ProMPMixture",
    "SmoothBox",
    "blend",
    "demonstrated_modes",
    "phases",
    "smooth_covariance",
]
