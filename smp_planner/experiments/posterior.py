"""The exact posterior p(w|O) of a scene in the plane, and the distance of particle sets to it.

Particles of SVGD, of one Gaussian, or on their own may all be free and yet be no draw from the
posterior: homotopy classes may have other weights in them, and paths of one class too little
spread. The measure is `inference.smc`, which is slow and right.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch

from smp_gym.arrays import FloatArray, IntArray
from smp_planner.benchmark.metrics import resample, wasserstein
from smp_planner.experiments.lasa_scenes import LasaScene
from smp_planner.experiments.paths import clearances, diversity
from smp_planner.experiments.set_measures import total_variation
from smp_planner.experiments.tables import Column
from smp_planner.inference.smc import SMCSettings, sample_posterior
from smp_planner.library.shapes import bodies
from smp_planner.library.smp import SMP, AdaptSettings
from smp_planner.movement_primitives import phases
from smp_planner.planning.ball import Ball, exact_map
from smp_planner.planning.modes import group

__all__ = ["Reference", "columns", "exact_draws", "posterior_row", "within_spread"]

_COMPARED = 1000


@dataclass(frozen=True)
class Reference:
    """Draws from the exact posterior.

    Attributes:
        paths: (R, T, 2) mm.
        signatures: (R, M) of `paths.classes`.
    """

    paths: FloatArray
    signatures: IntArray

    @cached_property
    def classes(self) -> IntArray:
        """(C, M) signatures of all homotopy classes in it, the likeliest first."""
        return group(self.signatures).signatures

    @cached_property
    def compared(self) -> FloatArray:
        """(`_COMPARED` or more, 50, 2) of its paths, evenly chosen, resampled."""
        return resample(self.paths[:: max(1, len(self.paths) // _COMPARED)])

    @cached_property
    def diversity(self) -> float:
        """Mean distance of two paths."""
        return diversity(self.compared)

    @cached_property
    def spread(self) -> float | None:
        """`within_spread` of all of it."""
        return within_spread(resample(self.paths), self.signatures)


def exact_draws(
    primitive: SMP,
    scene: LasaScene,
    settings: AdaptSettings,
    rng: np.random.Generator,
    smc: SMCSettings | None = None,
) -> FloatArray:
    """Return draws (R, T, 2) mm from p(w|O) ∝ exp(-λ C_obs(w)) p(w | goal), Eq. (8) and (12).

    Args:
        primitive: of one component.
        scene: obstacles and a goal, which the primitive is conditioned on; no via-points.
        settings: λ, margin, and the map's edge at its last width.
        rng: source of all randomness.
        smc: how to draw; R is its number of particles.

    Raises:
        ValueError: the primitive has several components, or the scene has via-points or no
            obstacle.
    """
    components = primitive.mixture.components
    if len(components) > 1 or scene.via_points or not scene.obstacles:
        raise ValueError(
            "an exact posterior needs one component, an obstacle and no via-points; got "
            f"{len(components)} components, {len(scene.obstacles)} obstacles and "
            f"{len(scene.via_points)} via-points"
        )
    prior, frame = components[0], primitive.frame
    if scene.goal is not None:
        prior = prior.condition(1.0, torch.from_numpy(frame.inwards(scene.goal)))
    placed = bodies(scene.obstacles, frame)
    cost, width = Ball(2).cost_on(exact_map(placed)), settings.edge_width[1]
    values = prior.basis.values(phases(settings.planning_steps))

    def log_likelihood(latent: FloatArray) -> FloatArray:
        weights = prior.unwhiten(torch.from_numpy(latent))
        paths = (values @ weights.unflatten(-1, (prior.basis.count, 2))).numpy()
        return -settings.obstacle_weight * cost(paths, width, settings.margin)[0]

    latent = sample_posterior(log_likelihood, prior.rank, rng, smc).particles
    paths = prior.trajectory(prior.unwhiten(torch.from_numpy(latent)), settings.samples)
    return frame.outwards(paths.numpy())


def within_spread(paths: FloatArray, signatures: IntArray) -> float | None:
    """Return the root mean square distance of paths from their class's mean; None if each is alone.

    Args:
        paths: (P, T, 2) mm.
        signatures: (P, M), that tell homotopy classes apart.
    """
    squares, degrees_of_freedom = 0.0, 0
    for members in group(signatures).members:
        own = paths[members]
        squares += float(np.square(own - own.mean(axis=0)).sum(axis=-1).mean(axis=-1).sum())
        degrees_of_freedom += len(own) - 1
    return math.sqrt(squares / degrees_of_freedom) if degrees_of_freedom else None


def posterior_row(
    name: str, paths: FloatArray, signatures: IntArray, reference: Reference, scene: LasaScene
) -> dict[str, str | float | None]:
    """Return measures of a set of particles against the exact posterior.

    `variation` is the total variation distance of the classes' weights; `wasserstein_exact` the
    distance to the posterior's paths; `diversity` the mean distance of two paths, and `spread`
    `within_spread`, both as shares of what they are in the posterior; `class_1` and so on are
    weights of the posterior's classes, the likeliest first.

    Args:
        name: of the setting.
        paths: (P, T, 2) mm.
        signatures: (P, M) of `paths.classes`.
        reference: the posterior.
        scene: of it.
    """
    alone, whole = within_spread(resample(paths), signatures), reference.spread
    shares = [float((signatures == of_one).all(axis=-1).mean()) for of_one in reference.classes]
    return {
        "setting": name,
        "free": float((clearances(paths, scene.obstacles) > 0.0).mean()),
        "classes": float(group(signatures).count),
        "variation": total_variation(signatures, reference.signatures),
        "wasserstein_exact": wasserstein(resample(paths), reference.compared),
        "diversity": diversity(resample(paths)) / reference.diversity,
        "spread": None if alone is None or whole is None else alone / whole,
        **{f"class_{number}": share for number, share in enumerate(shares, start=1)},
    }


def columns(reference: Reference, most: int = 4) -> tuple[Column, ...]:
    """Return the columns of the printed table of `posterior_row`s.

    Args:
        reference: the posterior.
        most: classes whose weights are printed.
    """
    numbers = range(1, min(most, len(reference.classes)) + 1)
    return (
        Column("setting", "Setting"),
        Column("free", "Free, share", 3),
        Column("classes", "Classes", 1, extremes=True),
        Column("variation", "Total variation of weights"),
        Column("wasserstein_exact", "W1 to posterior, mm"),
        Column("diversity", "Diversity, share"),
        Column("spread", "Spread within a class, share"),
        *(Column(f"class_{number}", f"Weight of class {number}") for number in numbers),
    )
