"""A prior in the plane, tied to its start."""

import torch

from smp_planner.movement_primitives import GaussianBasis, ProMP, smooth_covariance


def plane_prior() -> ProMP:
    """Return the prior."""
    basis = GaussianBasis(9)
    primitive = ProMP.from_covariance(
        basis,
        torch.zeros(18, dtype=torch.float64),
        smooth_covariance(basis, 2, 0.3, 0.25),
        torch.ones(2, dtype=torch.float64),
    )
    return primitive.condition(0.0, torch.zeros(2, dtype=torch.float64))
