"""Draws of a conditioned primitive, carried to a target, and judged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from smp_planner.adaptation import Adaptation
from smp_planner.library.conditioning import branches
from smp_planner.library.mover import Check
from smp_planner.library.target import SceneTarget, at_phase
from smp_planner.movement_primitives import ProMP, ProMPMixture, smooth_covariance
from smp_planner.movement_primitives.mixture import shared_out
from smp_planner.planners.base import Stopwatch

__all__ = ["Judged", "Particles", "adapted", "judged", "widened"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Particles:
    """Weights and where they come from.

    Attributes:
        weights: (P, K*D), in normalised coordinates.
        prior: (P,) half the squared distance from the conditioned primitive's mean, whitened.
        components: (P,) index of the component of the prior.
    """

    weights: Tensor
    prior: FloatArray
    components: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Judged:
    """What is known of particles, in normalised coordinates.

    Attributes:
        paths: (P, T, D).
        check: of the whole paths.
        missed: by how much (P,) each site is missed, by its name.
        passing: (P,) whether none is missed by more than the settings' `sigma`.
        costs: (P,) each, by name.
        chosen: index of the likeliest under the posterior of those that meet the most demands.
    """

    paths: FloatArray
    check: Check
    missed: dict[str, FloatArray]
    passing: BoolArray
    costs: dict[str, FloatArray]
    chosen: int

    @property
    def good(self) -> BoolArray:
        """(P,) as `PathPlan.good`."""
        return self.check.free & self.check.executable & self.passing

    @property
    def message(self) -> str:
        """Empty, or why no particle is good."""
        if self.good.any():
            return ""
        return (
            f"no particle is good: of {len(self.paths)} particles {int(self.check.free.sum())} are "
            f"collision-free, {int(self.check.executable.sum())} executable, "
            f"{int(self.passing.sum())} pass all they should; the least bad one is chosen"
        )


def widened(primitive: ProMP, std: float, length_scale: float, width: float) -> ProMP:
    """Return a primitive whose added freedom is `width` times as large.

    Args:
        primitive: with a freedom of standard deviation `std`.
        std: in extents.
        length_scale: of that freedom, in phase.
        width: at least 1.
    """
    if width <= 1.0:
        return primitive
    added = std * np.sqrt(width**2 - 1.0)
    return primitive.broaden(
        smooth_covariance(primitive.basis, primitive.dimension, added, length_scale)
    )


def adapted(
    prior: ProMPMixture,
    target: SceneTarget,
    way: Adaptation | None,
    count: int,
    seed: int,
    stopwatch: Stopwatch,
) -> Particles:
    """Return particles of a prior, conditioned on what is certain and carried to a target.

    Args:
        prior: each component keeps its share of the particles and is adapted on its own.
        target: the scene.
        way: how to adapt; None leaves the conditioned draws as they are.
        count: P.
        seed: of all randomness.
        stopwatch: notes the time of conditioning and inference.
    """
    sites = target.sites if target.settings.modulation == "exact" else ()
    rng = np.random.default_rng(seed)
    weights, distances, components = [], [], []
    shares = shared_out(count, prior.shares.tolist())
    for index, (component, share) in enumerate(zip(prior.components, shares, strict=True)):
        if not share:
            continue
        with stopwatch.stage("conditioning"):
            parts = branches(component, sites, share)
        for number, branch in enumerate(parts):
            primitive = branch.primitive
            latent = torch.from_numpy(rng.standard_normal((branch.count, primitive.rank)))
            if way is not None:
                own = np.random.default_rng([seed, 3, index, number])
                with stopwatch.stage("inference"):
                    latent = way.adapt(primitive, latent, target, own)
            weights.append(primitive.unwhiten(latent))
            distances.append(0.5 * latent.square().sum(-1))
            components += [index] * branch.count
    return Particles(torch.cat(weights), torch.cat(distances).numpy(), np.array(components))


def judged(particles: Particles, primitive: ProMP, target: SceneTarget) -> Judged:
    """Return what particles are worth.

    Args:
        particles: to be judged.
        primitive: any with the basis of their weights.
        target: the scene.
    """
    settings = target.settings
    paths = primitive.trajectory(particles.weights, settings.samples).numpy()
    check = target.mover.check(paths)
    missed = {site.name: site.missed(at_phase(paths, site.phase)) for site in target.sites}
    zero = np.zeros(len(paths))
    worst = np.max([zero, *missed.values()], axis=0)
    planned = primitive.trajectory(particles.weights, settings.planning_steps).numpy()
    costs = {"prior": particles.prior, **target.costs(planned)}
    passing = worst <= settings.sigma
    demanded = 4 * check.free + 2 * passing + 1 * check.executable
    likeliest = particles.prior + target.weighted_sum(planned)
    chosen = int(np.lexsort((-likeliest, demanded))[-1])
    return Judged(paths, check, missed, passing, costs, chosen)
