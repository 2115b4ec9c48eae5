"""Variational inference: Stein's with particles, and its baseline with one Gaussian.

`init` and `step` are those of Stein variational gradient descent, `init_gaussian` and
`step_gaussian` those of the Gaussian.
"""

from smp_planner.inference.annealing import cyclic_annealing, tanh_annealing
from smp_planner.inference.gaussian_vi import (
    GaussianState,
    GaussianVISettings,
    init_gaussian,
    step_gaussian,
)
from smp_planner.inference.stein_kernels import (
    RBF,
    InverseMultiquadric,
    MetricKernel,
    median_bandwidth,
    median_over_log_bandwidth,
)
from smp_planner.inference.svgd import (
    SETTINGS,
    State,
    SVGDSettings,
    converged,
    init,
    named_settings,
    stein_direction,
    step,
)

__all__ = [
    "RBF",
    "SETTINGS",
    "GaussianState",
    "GaussianVISettings",
    "InverseMultiquadric",
    "MetricKernel",
    "SVGDSettings",
    "State",
    "converged",
    "cyclic_annealing",
    "init",
    "init_gaussian",
    "median_bandwidth",
    "median_over_log_bandwidth",
    "named_settings",
    "stein_direction",
    "step",
    "step_gaussian",
    "tanh_annealing",
]
