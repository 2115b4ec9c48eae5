"""Stein movement primitives from demonstrations of one's own, without any environment.

    primitive = SMP.fit(demonstrations)
    plan = primitive.adapt([Circle((0.5, 0.2), 0.1)], goal=(1.0, 0.3), particles=42, seed=0)
    plan.trajectories, plan.collision_free, plan.best

Paths may be in the plane, in space or of a robot's joints, in any unit: lengths that are no
argument are shares of the demonstrations' extent, see `FitSettings` and `AdaptSettings`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from smp_planner.adaptation import Adaptation, Flow, GaussianVI, OptimisedMean, Stein
from smp_planner.library.adapting import adapted, judged, widened
from smp_planner.library.chain import with_collision_pairs
from smp_planner.library.cloud import PointCloud
from smp_planner.library.frame import Frame
from smp_planner.library.modulation import AnyOf, Box, ViaPoint
from smp_planner.library.plan import PathPlan
from smp_planner.library.reading import demonstrations_of
from smp_planner.library.scene import Scene
from smp_planner.library.settings import (
    JOINT_SMOOTH_STD,
    SMOOTH_STD,
    AdaptSettings,
    FitSettings,
)
from smp_planner.library.shapes import Circle, PathObstacle, Rectangle
from smp_planner.library.sites import Wanted, sites_of
from smp_planner.library.storing import read_primitive, write_primitive
from smp_planner.library.target import SceneTarget
from smp_planner.library.urdf import Robot
from smp_planner.movement_primitives import (
    GaussianBasis,
    ProMP,
    ProMPMixture,
    demonstrated_modes,
)
from smp_planner.planners.base import Stopwatch, one_thread
from smp_planner.planning.problem import GoalRegion

__all__ = [
    "METHODS",
    "SMP",
    "AdaptSettings",
    "AnyOf",
    "Box",
    "Circle",
    "FitSettings",
    "GoalRegion",
    "PathPlan",
    "PointCloud",
    "Rectangle",
    "Robot",
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

    Made by `SMP.fit` or `SMP.load`.

    Args:
        demonstrations: N arrays (T_j, D), at least two, at equal steps of phase.
        settings: how to learn from them.
        robot: of whose joints they are; None for paths in the plane or in space.

    Attributes:
        demonstrations: what it was learned from.
        settings: how it was learned.
        robot: as above, with the pairs of spheres that must stay clear of each other.
        frame: the normalised coordinates that the primitives live in.
        mixture: a component for each of the demonstrations' modes.
        single: one Gaussian for all demonstrations.
    """

    def __init__(
        self,
        demonstrations: Sequence[FloatArray],
        settings: FitSettings,
        robot: Robot | None = None,
    ) -> None:
        self.demonstrations = tuple(demonstrations)
        self.settings = settings
        dimension = self.demonstrations[0].shape[1]
        if robot is not None:
            if robot.dimension != dimension:
                raise ValueError(
                    f"demonstrations of a robot with {robot.dimension} joints must have as many "
                    f"coordinates, got {dimension}"
                )
            robot = Robot(with_collision_pairs(robot.model, self.demonstrations), robot.joints)
        self.robot = robot
        self.frame = _frame(self.demonstrations, robot)
        normal = [self.frame.inwards(d) for d in self.demonstrations]
        with one_thread():
            groups = demonstrated_modes(
                normal,
                GaussianBasis(settings.basis),
                modes=settings.modes,
                nan_is_missing=settings.nan_is_missing,
            )
            self.single = self._learn(normal)
            components = tuple(
                self.single if len(groups) == 1 else self._learn([normal[i] for i in group])
                for group in groups
            )
        self.mixture = ProMPMixture(components, torch.tensor([float(len(g)) for g in groups]))

    @classmethod
    def fit(cls, demonstrations: Any, robot: Robot | None = None, **settings: Any) -> SMP:
        """Learn a primitive from demonstrations.

        A coordinate that is constant in all of them stays allowed: its freedom is the one that is
        added (`FitSettings.smooth_std`).

        Args:
            demonstrations: (N, T, D), or N arrays (T_j, D), N at least 2, in any one unit, samples
                at equal steps of phase; or a `.npz` or `.csv` file, see
                `smp_planner.library.reading`.
            robot: of whose joints, rad, they are; None for paths in the plane or in space.
            **settings: see `FitSettings`.

        Raises:
            FileNotFoundError: no such file.
            ValueError: a file of another kind, fewer than two demonstrations, not all of one
                dimension or not that of the robot, a number that is not finite, all of them one
                point, or more modes than there are demonstrations for.
        """
        learning = FitSettings(**settings)
        given = demonstrations_of(demonstrations, nan_is_missing=learning.nan_is_missing)
        return cls(given, learning, robot)

    def save(self, path: str | Path) -> None:
        """Write an `.npz` file without pickled objects, which `load` reads."""
        write_primitive(path, self.demonstrations, self.settings, self.robot)

    @classmethod
    def load(cls, path: str | Path) -> SMP:
        """Read what `save` wrote; the primitive is learned again from the same demonstrations.

        Raises:
            FileNotFoundError: no such file.
            ValueError: it is damaged, is something else, or is of another version.
        """
        demonstrations, settings, robot = read_primitive(path)
        given = demonstrations_of(demonstrations, nan_is_missing=settings.nan_is_missing)
        return cls(given, settings, robot)

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
        obstacles: Sequence[PathObstacle] | PointCloud = (),
        *,
        start: Wanted | None = None,
        goal: Wanted | None = None,
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
        are in the unit of the demonstrations; for a robot, obstacles are in metres in the frame of
        its root link.

        Args:
            obstacles: `Circle`s and `Rectangle`s in the plane; in space and for a robot
                `smp_gym.scene.Obstacle`s and one `PointCloud`, which may also be given alone.
            start: (D,) where to begin, a `Box`, or `AnyOf` such; None leaves it as demonstrated.
            goal: likewise, where to end; for a robot also a `GoalRegion` of its tool.
            via_points: what to pass on the way; `AnyOf` several of one phase for a choice.
            radius: of the ball that moves; 0 is a point. A robot has none.
            particles: P.
            seed: of all randomness; the same call gives the same plan.
            method: one of `METHODS`, or a way to adapt; its lengths are in extents.
            per_component: whether each mode of the demonstrations is adapted on its own; if not,
                one Gaussian stands for all of them, as the paper's baselines have it.
            settings: map and costs.

        Raises:
            ValueError: an argument out of range, of another dimension than the demonstrations, or
                contradicting another; a start, goal or via-point inside an obstacle; or a region
                that the robot does not reach.
        """
        settings = settings or AdaptSettings()
        way = _method(method)
        if particles < 1:
            raise ValueError(f"particles must be at least 1, got {particles}")
        obstacles = (obstacles,) if isinstance(obstacles, PointCloud) else tuple(obstacles)
        stopwatch = Stopwatch()
        with one_thread():
            model = None if self.robot is None else self.robot.model
            sites = sites_of(self.frame, start, via_points, goal, settings.sigma, model)
            with stopwatch.stage("map"):
                scene = Scene(self.frame, self.robot, obstacles, radius)
                scene.refuse_blocked(sites, settings, self.demonstrations)
                mover = scene.mover(settings, seed, self.demonstrations, sites)
            target = SceneTarget(mover, sites, settings)
            prior = self.mixture if per_component else ProMPMixture((self.single,), torch.ones(1))
            attempts = settings.retries + 1 if way is not None else 1
            for attempt in range(attempts):
                wide = tuple(
                    widened(
                        component, self._smooth_std, self.settings.smooth_length_scale, 2.0**attempt
                    )
                    for component in prior.components
                )
                tried = adapted(
                    ProMPMixture(wide, prior.shares), target, way, particles, seed, stopwatch
                )
                with stopwatch.stage("verification"):
                    verdict = judged(tried, self.single, target)
                # Of attempts that all fail, the first has the demonstrations' own freedom.
                if attempt == 0 or verdict.good.any():
                    found, best = tried, verdict
                if best.good.any():
                    break
        scale = self.frame.scale
        return PathPlan(
            trajectories=self.frame.outwards(best.paths),
            weights=found.weights.numpy().reshape(particles, -1, self.dimension),
            costs=best.costs,
            collision_free=best.check.free,
            clearance=scale * best.check.clearance,
            executable=best.check.executable,
            duration=best.check.duration,
            missed={name: scale * value for name, value in best.missed.items()},
            passing=best.passing,
            components=found.components,
            chosen=best.chosen,
            timings=dict(stopwatch.timings),
            message=best.message,
            demonstrations=self.demonstrations,
            obstacles=obstacles,
            tool_paths=None if self.robot is None else self.robot.tool_positions(best.paths),
        )

    @property
    def _smooth_std(self) -> float:
        """Standard deviation of the added freedom, in extents."""
        if self.settings.smooth_std is not None:
            return self.settings.smooth_std
        return SMOOTH_STD if self.robot is None else JOINT_SMOOTH_STD

    def _learn(self, demonstrations: Sequence[FloatArray]) -> ProMP:
        return ProMP.fit(
            demonstrations,
            GaussianBasis(self.settings.basis),
            smooth_std=self._smooth_std,
            smooth_length_scale=self.settings.smooth_length_scale,
            nan_is_missing=self.settings.nan_is_missing,
        )


def _frame(demonstrations: Sequence[FloatArray], robot: Robot | None) -> Frame:
    """Return the coordinates in which the longest side of a box around all of them is 1."""
    lower = np.min([np.nanmin(d, axis=0) for d in demonstrations], axis=0)
    upper = np.max([np.nanmax(d, axis=0) for d in demonstrations], axis=0)
    scale = float((upper - lower).max())
    if scale == 0.0:
        raise ValueError(f"demonstrations must not all stand at one point, got {lower}")
    if robot is not None:
        return Frame(np.zeros(len(lower)), 1.0)
    return Frame((lower + upper) / 2, scale)


def _method(method: str | Adaptation | None) -> Adaptation | None:
    if method is None or isinstance(method, Adaptation):
        return method
    if method not in METHODS:
        raise ValueError(
            f"method must be one of {', '.join(METHODS)}, or a way to adapt; got {method!r}"
        )
    return METHODS[method]
