"""Stein movement primitives from demonstrations of one's own, without any environment.

    primitive = SMP.fit(demonstrations)
    plan = primitive.adapt([Circle((0.5, 0.2), 0.1)], goal=(1.0, 0.3), particles=42, seed=0)
    plan.trajectories, plan.collision_free, plan.best

Paths may be in the plane, in space or of a robot's joints, in any unit: lengths that are no
argument are shares of the demonstrations' extent (`smp_planner.library.settings`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from smp_planner.adaptation import Adaptation, Flow, GaussianVI, OptimisedMean, Stein
from smp_planner.library.conditioning import branches
from smp_planner.library.modulation import AnyOf, Box, Site, ViaPoint
from smp_planner.library.mover import Mover
from smp_planner.library.plan import PathPlan
from smp_planner.library.point import Ball, exact_map
from smp_planner.library.reading import demonstrations_of
from smp_planner.library.settings import AdaptSettings, FitSettings
from smp_planner.library.shapes import Circle, PathObstacle, Rectangle, bodies
from smp_planner.library.sites import Frame, sites_of
from smp_planner.library.target import SceneTarget, at_phase
from smp_planner.movement_primitives import (
    GaussianBasis,
    ProMP,
    ProMPMixture,
    demonstrated_modes,
    smooth_covariance,
)
from smp_planner.movement_primitives.mixture import shared_out
from smp_planner.planners.base import Stopwatch, one_thread
from smp_planner.planners.judging import choose
from smp_planner.verification import Verification

__all__ = [
    "METHODS",
    "SMP",
    "AdaptSettings",
    "AnyOf",
    "Box",
    "Circle",
    "FitSettings",
    "PathPlan",
    "Rectangle",
    "ViaPoint",
]

FloatArray = NDArray[np.float64]

METHODS: dict[str, Adaptation | None] = {
    "smp": Stein(),
    "cpromp": GaussianVI(),
    "prompt_o": OptimisedMean(),
    "promp_diff": Flow(),
    "promp": None,
}
"""Ways to adapt, by name: Stein's, the paper's baselines, and conditioning alone."""


class SMP:
    """A movement primitive learned from demonstrations, to be adapted to scenes.

    Made by `SMP.fit`.

    Args:
        demonstrations: N arrays (T_j, D), at least two, at equal steps of phase.
        settings: how to learn from them.

    Attributes:
        demonstrations: what it was learned from.
        settings: how it was learned.
        frame: the normalised coordinates that the primitives live in.
        mixture: a component for each of the demonstrations' modes.
        single: one Gaussian for all demonstrations.
    """

    def __init__(self, demonstrations: Sequence[FloatArray], settings: FitSettings) -> None:
        self.demonstrations = tuple(demonstrations)
        self.settings = settings
        self.frame = _frame(self.demonstrations)
        normal = [self.frame.inwards(d) for d in self.demonstrations]
        groups = _modes(normal, settings)
        with one_thread():
            self.single = self._learn(normal)
            components = (
                (self.single,)
                if len(groups) == 1
                else tuple(self._learn([normal[i] for i in members]) for members in groups)
            )
        self.mixture = ProMPMixture(components, torch.tensor([float(len(g)) for g in groups]))

    @classmethod
    def fit(cls, demonstrations: Any, **settings: Any) -> SMP:
        """Learn a primitive from demonstrations.

        Args:
            demonstrations: (N, T, D), or N arrays (T_j, D), N at least 2, in any one unit; samples
                stand at equal steps of phase.
            **settings: see `FitSettings`.

        Raises:
            ValueError: fewer than two demonstrations, not all of one dimension, a number that is
                not finite, all of them one point, or more modes than there are demonstrations for.
        """
        return cls(demonstrations_of(demonstrations), FitSettings(**settings))

    @property
    def dimension(self) -> int:
        """D, the number of coordinates."""
        return self.frame.dimension

    @property
    def extent(self) -> float:
        """What the lengths in settings are shares of, in the unit of the demonstrations."""
        return self.frame.scale

    def adapt(
        self,
        obstacles: Sequence[PathObstacle] = (),
        *,
        start: ArrayLike | Box | AnyOf | None = None,
        goal: ArrayLike | Box | AnyOf | None = None,
        via_points: Sequence[ViaPoint | AnyOf] = (),
        radius: float = 0.0,
        particles: int = 42,
        seed: int = 0,
        method: str | Adaptation | None = "smp",
        per_component: bool = True,
        settings: AdaptSettings | None = None,
    ) -> PathPlan:
        """Return particles of the primitive, adapted to a scene.

        Each of the demonstrations' modes keeps its share of the particles. Positions and lengths
        are in the unit of the demonstrations.

        Args:
            obstacles: `Circle`s and `Rectangle`s in the plane, `smp_gym.scene.Obstacle`s in space.
            start: (D,) where to begin, a `Box`, or `AnyOf` such; None leaves it as demonstrated.
            goal: likewise, where to end.
            via_points: what to pass on the way; `AnyOf` several of one phase for a choice.
            radius: of the ball that moves; 0 is a point.
            particles: P.
            seed: of all randomness; the same call gives the same plan.
            method: one of `METHODS`, or a way to adapt; its lengths are in extents.
            per_component: whether each mode of the demonstrations is adapted on its own; if not,
                one Gaussian stands for all of them, as the paper's baselines have it.
            settings: map and costs.

        Raises:
            ValueError: an argument out of range, of another dimension than the demonstrations, or
                contradicting another; or a start, goal or via-point inside an obstacle.
        """
        settings = settings or AdaptSettings()
        way = _method(method)
        if particles < 1:
            raise ValueError(f"particles must be at least 1, got {particles}")
        if not (np.isfinite(radius) and radius >= 0.0):
            raise ValueError(f"radius must not be negative, got {radius}")
        obstacles = tuple(obstacles)
        stopwatch = Stopwatch()
        with one_thread():
            sites = sites_of(self.frame, start, via_points, goal, settings.sigma)
            with stopwatch.stage("map"):
                mover = self._mover(obstacles, radius)
            target = SceneTarget(mover, sites, settings)
            prior = self.mixture if per_component else ProMPMixture((self.single,), torch.ones(1))
            best: PathPlan | None = None
            for attempt in range(settings.retries + 1 if way is not None else 1):
                plan = self._attempt(
                    prior, target, way, particles, seed, 2.0**attempt, obstacles, stopwatch
                )
                if best is None or plan.good.any() > best.good.any():
                    best = plan
                if best.good.any():
                    break
            assert best is not None
        return replace(best, timings=dict(stopwatch.timings))

    def _learn(self, demonstrations: Sequence[FloatArray]) -> ProMP:
        return ProMP.fit(
            demonstrations,
            GaussianBasis(self.settings.basis),
            smooth_std=self.settings.smooth_std,
            smooth_length_scale=self.settings.smooth_length_scale,
        )

    def _mover(self, obstacles: Sequence[PathObstacle], radius: float) -> Mover:
        placed = bodies(obstacles, self.dimension, self.frame.offset, self.frame.scale)
        distance = exact_map(placed) if placed else None
        return Ball(placed, radius / self.frame.scale, distance)

    def _widened(self, primitive: ProMP, width: float) -> ProMP:
        if width <= 1.0:
            return primitive
        added = self.settings.smooth_std * np.sqrt(width**2 - 1.0)
        length_scale = self.settings.smooth_length_scale
        return primitive.broaden(
            smooth_covariance(primitive.basis, primitive.dimension, added, length_scale)
        )

    def _attempt(
        self,
        prior: ProMPMixture,
        target: SceneTarget,
        way: Adaptation | None,
        particles: int,
        seed: int,
        width: float,
        obstacles: tuple[PathObstacle, ...],
        stopwatch: Stopwatch,
    ) -> PathPlan:
        exact = target.settings.modulation == "exact"
        conditioned: tuple[Site, ...] = target.sites if exact else ()
        rng = np.random.default_rng(seed)
        weights, latents, components = [], [], []
        counts = shared_out(particles, prior.shares.tolist())
        for index, (component, count) in enumerate(zip(prior.components, counts, strict=True)):
            if not count:
                continue
            with stopwatch.stage("conditioning"):
                parts = branches(self._widened(component, width), conditioned, count)
            for number, branch in enumerate(parts):
                primitive = branch.primitive
                latent = torch.from_numpy(rng.standard_normal((branch.count, primitive.rank)))
                if way is not None:
                    own = np.random.default_rng([seed, 3, index, number])
                    with stopwatch.stage("inference"):
                        latent = way.adapt(primitive, latent, target, own)
                weights.append(primitive.unwhiten(latent))
                latents.append(0.5 * latent.square().sum(-1))
                components += [index] * branch.count
        return self._judged(
            torch.cat(weights),
            torch.cat(latents).numpy(),
            np.array(components),
            target,
            obstacles,
            stopwatch,
        )

    def _judged(
        self,
        weights: torch.Tensor,
        prior: FloatArray,
        components: NDArray[np.int64],
        target: SceneTarget,
        obstacles: tuple[PathObstacle, ...],
        stopwatch: Stopwatch,
    ) -> PathPlan:
        settings, primitive = target.settings, self.single
        with stopwatch.stage("verification"):
            paths = primitive.trajectory(weights, settings.samples).numpy()
            check = target.mover.check(paths)
            missed = {site.name: site.missed(at_phase(paths, site.phase)) for site in target.sites}
            zero = np.zeros(len(paths))
            worst = np.max([zero, *missed.values()], axis=0)
            passing = worst <= settings.sigma
            costs = {"prior": prior}
            costs |= target.costs(primitive.trajectory(weights, settings.planning_steps).numpy())
            verdict = Verification(
                check.free,
                check.free,
                check.clearance,
                check.executable,
                check.duration,
                check.executable,
            )
            chosen = choose(
                verdict, missed.get("goal", zero), np.maximum(worst - settings.sigma, 0.0), costs
            )
        message = ""
        if not (check.free & check.executable & passing).any():
            message = (
                f"no particle is good: of {len(paths)} particles {int(check.free.sum())} are "
                f"collision-free, {int(check.executable.sum())} executable, "
                f"{int(passing.sum())} pass all they should; the least bad one is chosen"
            )
        scale = self.frame.scale
        return PathPlan(
            trajectories=self.frame.outwards(paths),
            weights=weights.numpy().reshape(-1, primitive.basis.count, self.dimension),
            costs=costs,
            collision_free=check.free,
            clearance=scale * check.clearance,
            executable=check.executable,
            duration=check.duration,
            missed={name: scale * value for name, value in missed.items()},
            passing=passing,
            components=components,
            chosen=chosen,
            timings={},
            message=message,
            demonstrations=self.demonstrations,
            obstacles=obstacles,
        )


def _frame(demonstrations: Sequence[FloatArray]) -> Frame:
    lower = np.min([d.min(axis=0) for d in demonstrations], axis=0)
    upper = np.max([d.max(axis=0) for d in demonstrations], axis=0)
    scale = float((upper - lower).max())
    if scale == 0.0:
        raise ValueError(f"demonstrations must not all stand at one point, got {lower}")
    return Frame((lower + upper) / 2, scale)


def _modes(normal: Sequence[FloatArray], settings: FitSettings) -> tuple[tuple[int, ...], ...]:
    """Return the indices of the demonstrations that each mode is learned from."""
    if settings.modes is None:
        return demonstrated_modes(normal, GaussianBasis(settings.basis))
    if settings.modes == 1:
        return (tuple(range(len(normal))),)
    raise NotImplementedError


def _method(method: str | Adaptation | None) -> Adaptation | None:
    if method is None or isinstance(method, Adaptation):
        return method
    if method not in METHODS:
        raise ValueError(
            f"method must be one of {', '.join(METHODS)}, or a way to adapt; got {method!r}"
        )
    return METHODS[method]
