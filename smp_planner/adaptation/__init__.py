"""How a primitive is adapted to what it has not seen: Stein's way, and the paper's baselines.

These know trajectories and their costs only, no arm and no scene.
"""

from smp_planner.adaptation.flow import Flow
from smp_planner.adaptation.gaussian import GaussianAdaptation
from smp_planner.adaptation.optimised_mean import OptimisedMean
from smp_planner.adaptation.stein import Stein
from smp_planner.adaptation.target import Adaptation, Good, Target
from smp_planner.adaptation.variational import GaussianVI

__all__ = [
    "Adaptation",
    "Flow",
    "GaussianAdaptation",
    "GaussianVI",
    "Good",
    "OptimisedMean",
    "Stein",
    "Target",
]
