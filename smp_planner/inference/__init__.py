"""Stein variational gradient descent: `init`, `step`, kernels, optimisers and schedules."""

from smp_planner.inference.kernels import RBF, median_bandwidth, median_over_log_bandwidth
from smp_planner.inference.svgd import (
    SETTINGS,
    State,
    SVGDSettings,
    init,
    named_settings,
    stein_direction,
    step,
)

__all__ = [
    "RBF",
    "SETTINGS",
    "SVGDSettings",
    "State",
    "init",
    "median_bandwidth",
    "median_over_log_bandwidth",
    "named_settings",
    "stein_direction",
    "step",
]
