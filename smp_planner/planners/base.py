"""What all planners with a primitive share: learning it, tying it to a scene, making plans."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor

from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.robot.kinematics import UnreachableError
from smp_planner.collision.robot_model import RobotModel, jaco_model, jaco_of_spheres
from smp_planner.collision.verification import Verification, check_collisions, verify
from smp_planner.movement_primitives import (
    GaussianBasis,
    ProMP,
    ProMPMixture,
    demonstrated_modes,
    smooth_covariance,
)
from smp_planner.movement_primitives.mixture import shared_out
from smp_planner.planners.judging import (
    REACHED,
    goal_distances,
    missed_via_points,
    rank,
    signatures,
)
from smp_planner.planners.tying import TiedPrimitive, tie_primitive
from smp_planner.planning.problem import Plan, Problem, ViaPoint

__all__ = ["Particles", "PlannerModel", "PlannerSettings", "Stopwatch", "one_thread"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

SAMPLES = 200
"""T of the trajectories in a plan, as in the demonstrations."""


class PlannerSettings(BaseModel):
    """Settings that all planners have.

    Attributes:
        particles: P, size of the set.
        smooth_std: rad, freedom added to what the demonstrations teach; see `ProMP.fit`.
        smooth_length_scale: of that freedom, l in phase. Trajectories come out smoother than their
            weights: away from the ends as if it were sqrt(l^2 + 2 / (K - 3)^2).
        basis_functions: K of the primitive, 1 / (K - 3) of the phase apart.
        duration_limit: s, within which an executable trajectory must be feasible.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    particles: int = Field(default=42, ge=1)
    smooth_std: float = Field(default=0.2, gt=0.0, allow_inf_nan=False)
    smooth_length_scale: float = Field(default=0.2, gt=0.0, allow_inf_nan=False)
    basis_functions: int = Field(default=15, ge=4)
    duration_limit: float = Field(default=15.0, gt=0.0, allow_inf_nan=False)


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep torch to one thread: its matrices are small here, and waking others costs more."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


class Stopwatch:
    """Seconds of the stages of a plan by name, in order."""

    def __init__(self) -> None:
        self.timings: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time spent inside to a stage."""
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.timings[name] = self.timings.get(name, 0.0) + time.perf_counter() - begin


@dataclass(frozen=True)
class Particles:
    """The part of a set that belongs to one component of the prior.

    Attributes:
        component: its index.
        tied: the component, conditioned.
        latent: (P_c, r) particles in its whitened coordinates.
    """

    component: int
    tied: TiedPrimitive
    latent: Tensor


class PlannerModel(ABC):
    """A planner that has learned a primitive from demonstrations.

    Args:
        demonstrations: what to learn from.
        settings: an instance of the class's `Settings`.

    Attributes:
        primitive: one Gaussian for all demonstrations.
        mixture: a component for each of the ways that they go; the same Gaussian if there is but
            one.
    """

    name: ClassVar[str]
    Settings: ClassVar[type[PlannerSettings]] = PlannerSettings

    def __init__(
        self, demonstrations: Demonstrations, settings: PlannerSettings | None = None
    ) -> None:
        self.demonstrations = demonstrations
        self.settings = self.Settings() if settings is None else settings
        self.primitive = ProMP.fit(
            np.array(demonstrations.configurations),
            GaussianBasis(self.settings.basis_functions),
            smooth_std=self.settings.smooth_std,
            smooth_length_scale=self.settings.smooth_length_scale,
        )
        self.mixture = self._learn_mixture()

    def _learn_mixture(self) -> ProMPMixture:
        configurations = list(np.array(self.demonstrations.configurations))
        modes = demonstrated_modes(configurations, self.primitive.basis)
        if len(modes) == 1:
            return ProMPMixture((self.primitive,), torch.ones(1))
        return ProMPMixture.fit(
            configurations,
            self.primitive.basis,
            smooth_std=self.settings.smooth_std,
            smooth_length_scale=self.settings.smooth_length_scale,
        )

    def plan(self, problems: Sequence[Problem]) -> list[Plan]:
        """Return one plan for each problem; the same problem gives the same plan."""
        with one_thread():
            return [self._plan(problem) for problem in problems]

    @abstractmethod
    def _plan(self, problem: Problem) -> Plan:
        """Return the plan for one problem."""

    def tie(
        self,
        problem: Problem,
        robot: RobotModel,
        width: float = 1.0,
        through: Sequence[ViaPoint] = (),
    ) -> TiedPrimitive:
        """Return the primitive conditioned on start and goal of a problem.

        Args:
            problem: to be solved.
            robot: arm with all that it carries.
            width: factor of `smooth_std`, at least 1.
            through: via-points to condition on, too.

        Raises:
            UnreachableError: no goal is within reach.
        """
        return tie_primitive(self._widened(self.primitive, width), problem, robot, through)

    def _widened(self, primitive: ProMP, width: float) -> ProMP:
        if width <= 1.0:
            return primitive
        added = self.settings.smooth_std * np.sqrt(width**2 - 1.0)
        return primitive.broaden(
            smooth_covariance(
                primitive.basis, primitive.dimension, added, self.settings.smooth_length_scale
            )
        )

    def draw(
        self,
        problem: Problem,
        robot: RobotModel,
        width: float = 1.0,
        through: Sequence[ViaPoint] = (),
    ) -> list[Particles]:
        """Return P draws of the mixture, conditioned on start and goal of a problem.

        Each component is tied to the goal that is likeliest under it, and gets its share of the
        particles; a component that reaches no goal gets none, and the others share them out.

        Args:
            problem: to be solved.
            robot: arm with all that it carries.
            width: factor of `smooth_std`, at least 1.
            through: via-points to condition on, too.

        Raises:
            UnreachableError: no component reaches a goal.
        """
        tied: dict[int, TiedPrimitive] = {}
        unreachable: UnreachableError | None = None
        for index, component in enumerate(self.mixture.components):
            try:
                tied[index] = tie_primitive(
                    self._widened(component, width), problem, robot, through
                )
            except UnreachableError as error:
                unreachable = error
        if not tied:
            assert unreachable is not None
            raise unreachable
        counts = shared_out(
            self.settings.particles, [float(self.mixture.shares[index]) for index in tied]
        )
        rng = np.random.default_rng(problem.seed)
        return [
            Particles(
                index,
                primitive,
                torch.from_numpy(rng.standard_normal((count, primitive.primitive.rank))),
            )
            for (index, primitive), count in zip(tied.items(), counts, strict=True)
            if count
        ]

    def plan_of(
        self,
        problem: Problem,
        robot: RobotModel,
        particles: Sequence[Particles],
        costs: dict[str, FloatArray],
        stopwatch: Stopwatch,
    ) -> Plan:
        """Return the plan that particles of the primitive amount to.

        Args:
            problem: to be solved.
            robot: arm with all that it carries.
            particles: of all components, P together.
            costs: what is known already of each particle, each (P,).
            stopwatch: its stages go into the plan.
        """
        primitive = particles[0].tied.primitive
        weights = torch.cat([p.tied.primitive.unwhiten(p.latent) for p in particles])
        prior = torch.cat([0.5 * p.latent.square().sum(-1) for p in particles])
        components = None
        if len(self.mixture.components) > 1:
            components = np.repeat(
                [p.component for p in particles], [len(p.latent) for p in particles]
            )
        return self.judge(
            problem,
            robot,
            primitive.trajectory(weights, SAMPLES).numpy(),
            weights.numpy().reshape(-1, primitive.basis.count, primitive.dimension),
            {"prior": prior.numpy(), **costs},
            stopwatch,
            components=components,
        )

    def good(self, problem: Problem, robot: RobotModel, trajectories: FloatArray) -> BoolArray:
        """Return which of (P, T, D) trajectories, rad, are good and reach the goal, (P,)."""
        verdict = _verified(trajectories, robot, problem, self.settings.duration_limit)
        passing = missed_via_points(problem, robot, trajectories) <= 0.0
        reaching = goal_distances(problem, robot, trajectories[:, -1]).min(axis=0) < REACHED
        return verdict.collision_free & verdict.executable & passing & reaching

    def judge(
        self,
        problem: Problem,
        robot: RobotModel,
        trajectories: FloatArray,
        weights: FloatArray,
        costs: dict[str, FloatArray],
        stopwatch: Stopwatch,
        *,
        components: NDArray[np.int64] | None = None,
        reason: str = "no particle is good",
    ) -> Plan:
        """Return the plan that trajectories amount to: verified, and the best of them chosen.

        Args:
            problem: to be solved.
            robot: arm with all that it carries.
            trajectories: (P, T, D) rad.
            weights: (P, K, D) of the primitive.
            costs: what is known already of each particle, each (P,), `prior` among them.
            stopwatch: its stages go into the plan.
            components: (P,), see `Plan`.
            reason: what the plan's message begins with if no particle is good.
        """
        with stopwatch.stage("verification"):
            verdict = _verified(trajectories, robot, problem, self.settings.duration_limit)
            distances = goal_distances(problem, robot, trajectories[:, -1])
            goal_error = distances.min(axis=0)
            missed = missed_via_points(problem, robot, trajectories)
            ranks = rank(verdict, goal_error, missed, costs)
            ways = signatures(problem, robot, trajectories, distances.argmin(axis=0))
        free, executable, passing = verdict.collision_free, verdict.executable, missed <= 0.0
        message = ""
        if not (free & executable & passing).any():
            message = (
                f"{reason}: of {len(free)} particles {int(free.sum())} are collision-free, "
                f"{int(executable.sum())} executable, {int(passing.sum())} pass all via-points; "
                "the least bad one is chosen"
            )
        return Plan(
            weights=weights,
            trajectories=trajectories,
            costs=costs,
            collision_free=free,
            clearance=verdict.clearance,
            goal_error=goal_error,
            duration=verdict.duration,
            executable=executable,
            chosen=int(ranks.argmin()),
            timings=stopwatch.timings,
            message=message,
            components=components,
            passing=passing,
            signatures=ways,
            ranks=ranks,
        )


def _verified(
    trajectories: FloatArray, robot: RobotModel, problem: Problem, duration_limit: float
) -> Verification:
    """Return what `verify` finds, with collisions looked for stage by stage if there are stages."""
    if not problem.stages:
        return verify(trajectories, robot, problem.obstacles, duration_limit)
    whole = verify(trajectories, robot, (), duration_limit)
    free, clearance = whole.collision_free, whole.clearance
    for stage in problem.stages:
        part = trajectories[:, stage.steps(trajectories.shape[1])]
        check = check_collisions(part, jaco_of_spheres(stage.spheres), stage.obstacles)
        free, clearance = free & check.free, np.minimum(clearance, check.clearance)
    return replace(whole, collision_free=free, clearance=clearance)


def jaco_with(problem: Problem) -> RobotModel:
    """Return the arm with the spheres that a problem attaches to its hand."""
    return jaco_model(problem.attached)
