"""Table I: numbers of ends in a region, with and without the smooth box prior.

The paper gives neither region nor scene. The reading taken: obstacles move all of a path, its ends
too, which are not conditioned on. The region is fixed beforehand: the box of two standard
deviations of the learned primitive on either side of its mean, in each coordinate, where 91 of 100
ends of a Gaussian lie before any adaptation. Demonstrated ends alone give no region, because those
of LASA all lie at the origin. Starts are treated alike, with a box for each letter. The prior's box
is the region drawn in by one σ on every side, so that its tails begin inside the region.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal

import numpy as np
from rich.progress import track

from smp_gym.arrays import FloatArray
from smp_planner.experiments.lasa_scenes import (
    FIGURE_1,
    FIGURE_2B,
    LASA_METHODS,
    LasaScene,
    Method,
    learn,
)
from smp_planner.experiments.paths import clearances
from smp_planner.experiments.tables import Column, Row
from smp_planner.library.smp import SMP, AnyOf, Box

__all__ = ["BOX_PRIORS", "COLUMNS", "TAIL", "box_row", "box_rows", "regions"]

TAIL = 0.25
"""mm, σ of Eq. (14)."""

BOX_PRIORS: Mapping[str, bool | None] = MappingProxyType(
    {"without": None, "with, 2 σ²": False, "with, √2 σ² as printed": True}
)
"""Readings of Eq. (14), by name: as printed or not; None is without the smooth box prior."""

_PAPER = {
    ("Sshape", False): "40/42",
    ("Sshape", True): "42/42",
    ("Sshape+WShape", False): "36/42",
    ("Sshape+WShape", True): "42/42",
}
"""Ends in the region by shape, and whether with the smooth box prior; the paper's Table I."""

COLUMNS = (
    Column("shape", "Shape"),
    Column("prior", "Smooth box prior"),
    Column("ends", "Ends in region", 1, extremes=True),
    Column("paper", "Ends, paper"),
    Column("starts", "Starts in region", 1, extremes=True),
    Column("free", "Free", 1, extremes=True),
)
"""Columns of the printed table of `box_row`s."""

_STDS = 2.0


def regions(primitive: SMP, phase: Literal[0, 1]) -> tuple[Box, ...]:
    """Return the boxes in which most paths of the unadapted primitive start or end.

    Args:
        primitive: of one component or several.
        phase: 0 gives a box for each component, 1 one for all of them together.
    """
    components = primitive.mixture.components
    marginals = [component.marginal(phase) for component in components]
    means = np.array([mean.numpy() for mean, _ in marginals])
    variances = np.array([covariance.diagonal().numpy() for _, covariance in marginals])
    if phase == 1:
        shares = primitive.mixture.shares.numpy()[:, None]
        mean = (shares * means).sum(axis=0)
        variances = (shares * (variances + np.square(means - mean))).sum(axis=0)[None]
        means = mean[None]
    half = _STDS * np.sqrt(variances) * primitive.extent
    middle = primitive.frame.outwards(means)
    return tuple(Box(m - h, m + h, TAIL) for m, h in zip(middle, half, strict=True))


def box_rows(particles: int, repetitions: int) -> list[Row]:
    """Return the rows of Table I: each of the `BOX_PRIORS` in the scenes of Fig. 1 and Fig. 2b.

    Args:
        particles: P.
        repetitions: with seeds from 0.
    """
    rows: list[Row] = []
    for scene in (FIGURE_1, FIGURE_2B):
        primitive, method = learn(scene.shape), LASA_METHODS["smp"]
        for seed in track(range(repetitions), scene.shape):
            rows += [
                box_row(prior, primitive, scene, method, particles, seed) for prior in BOX_PRIORS
            ]
    return rows


def box_row(
    prior: str, primitive: SMP, scene: LasaScene, method: Method, particles: int, seed: int
) -> dict[str, str | float | None]:
    """Return the numbers of starts and ends in their regions after an adaptation.

    Args:
        prior: one of `BOX_PRIORS`.
        primitive: of the scene's shape.
        scene: obstacles only count; neither start nor goal is conditioned on.
        method: how to adapt.
        particles: P.
        seed: of the plan.
    """
    first, last = regions(primitive, 0), regions(primitive, 1)
    paper_scale = BOX_PRIORS[prior]
    start, goal = None, None
    if paper_scale is not None:
        start, goal = (AnyOf([_drawn_in(b, paper_scale) for b in boxes]) for boxes in (first, last))
    paths = primitive.adapt(
        scene.obstacles,
        start=start,
        goal=goal,
        particles=particles,
        seed=seed,
        method=method.adaptation,
        settings=method.settings,
    ).trajectories
    return {
        "shape": scene.shape,
        "prior": prior,
        "paper": _PAPER.get((scene.shape, paper_scale is not None), "–"),
        "seed": seed,
        "ends": _inside(paths[:, -1], last),
        "starts": _inside(paths[:, 0], first),
        "free": float((clearances(paths, scene.obstacles) > 0.0).sum()),
    }


def _drawn_in(region: Box, paper_scale: bool) -> Box:
    return Box(region.lower + TAIL, region.upper - TAIL, TAIL, paper_scale)


def _inside(points: FloatArray, boxes: tuple[Box, ...]) -> float:
    """Return the number of points (P, 2) in one of the boxes."""
    inside = [((b.lower <= points) & (points <= b.upper)).all(axis=-1) for b in boxes]
    return float(np.any(inside, axis=0).sum())
