"""Adaptations that keep one Gaussian over the weights, as the paper's baselines do."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import wraps
from typing import Any

import numpy as np
import torch
from torch import Tensor

from smp_planner.adaptation.runs import Adapt, Good, Runs, SceneCosts, Target
from smp_planner.movement_primitives import ProMP

__all__ = ["AdaptGaussian", "one_gaussian"]

AdaptGaussian = Callable[[ProMP, SceneCosts, np.random.Generator, Any], tuple[Tensor, Tensor]]
"""Map from a prior, its scene, a generator and settings to a Gaussian, mean (r,) and factor (r, r),
in the prior's whitened coordinates, where the prior is N(0, I)."""


def one_gaussian(adapt_gaussian: AdaptGaussian) -> Adapt:
    """Return the adaptation that carries draws of the prior to an adapted Gaussian, run by run.

    One that leaves the Gaussian as it was ends with the draws that it began with.
    """

    @wraps(adapt_gaussian)
    def adapt(
        runs: Runs,
        latent: Tensor,
        target: Target,
        rngs: Sequence[np.random.Generator],
        settings: Any,
        good: Good | None = None,
    ) -> Tensor:
        carried = []
        for primitive, scene, rng, drawn in zip(
            runs.primitives, target.scenes, rngs, latent, strict=True
        ):
            mean, factor = adapt_gaussian(primitive, scene, rng, settings)
            carried.append(mean + drawn @ factor.mT)
        return torch.stack(carried)

    return adapt
