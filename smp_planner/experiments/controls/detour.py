"""The fixed detour: one detour on the conditioned mean for all scenes, which looks at none.

A policy that is blind to obstacles: the primitive is conditioned as `smp` conditions it, and to its
mean one and the same detour is added in every scene, three smooth functions of the phase for each
joint, 18 numbers. It is learned on other scenes by a search over these numbers (cross-entropy
method with full covariance, rank-weighted as in Hansen 2016, arXiv:1604.00772, several restarts)
whose objective is how many scenes the detour leaves free.

Where the trajectory is held on its course (via-points, the poses of a push), what the detour would
change there is conditioned away: of a Gaussian prior, adding a detour before conditioning adds
(I - K H) of it afterwards. So no number is lost on what the constraints forbid, and where they only
hold the ends, where the detour vanishes with its slope, it is added as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.geometry.distance import PackedObstacles
from smp_gym.robot.kinematics import UnreachableError
from smp_gym.sampling.blind_detours import FUNCTIONS, detour_functions
from smp_planner.collision.verification import minimum_duration, within_joint_limits
from smp_planner.experiments.controls.posed_scenes import primitive_of
from smp_planner.experiments.controls.sampled_clearance import sampled_clearance
from smp_planner.movement_primitives import ProMP
from smp_planner.planning.assessment import assess
from smp_planner.planning.bodies import RobotBody
from smp_planner.planning.constraints import ToolPath
from smp_planner.planning.pipeline import condition
from smp_planner.planning.problem import Problem
from smp_planner.torch_threads import one_thread

__all__ = [
    "Course",
    "Detour",
    "SearchSettings",
    "conditioned_course",
    "detours_free",
    "learn_detour",
]

_SAMPLES = 200
_STRIDE = 5
"""Samples of a trajectory, and every how many of them the search looks at one."""

_FLOOR = -0.03
_SOFTNESS = (0.015, 0.003)
_BETWEEN = 0.003
"""Metres: least clearance told apart, softness of the objective in the first and last generation,
and clearance demanded at the samples for what lies between them."""


@dataclass(frozen=True)
class SearchSettings:
    """Settings of the search for a detour.

    Attributes:
        generations: of each restart.
        restarts: how many; the best on the validation scenes is kept.
        population: detours in a generation.
        scenes: training scenes that a generation is compared on, all on the same.
        screened: random detours of which the best begin the restarts.
        deviation: rad, of the widest of these.
        validation: share of the scenes that are kept for the choice between restarts.
    """

    generations: int = 40
    restarts: int = 3
    population: int = 64
    scenes: int = 48
    screened: int = 384
    deviation: float = 0.6
    validation: float = 0.3


@dataclass(frozen=True, eq=False)
class Course:
    """The conditioned mean in a scene, and how a detour changes it there.

    Attributes:
        problem: that the scene poses.
        mean: (T, 6) rad.
        directions: (F, T, 6) rad, by which the mean changes for each number of a detour.
    """

    problem: Problem
    mean: FloatArray
    directions: FloatArray

    def trajectories(self, numbers: FloatArray, stride: int = 1) -> FloatArray:
        """Return the trajectories (C, T, 6) rad of detours (C, F)."""
        directions = self.directions[:, ::stride]
        changed = numbers @ directions.reshape(len(directions), -1)
        return self.mean[::stride] + changed.reshape(len(numbers), *directions.shape[1:])


@dataclass(frozen=True, eq=False)
class Detour:
    """A learned detour.

    Attributes:
        numbers: (F,) rad, of each function and joint, functions first.
        component: of the prior, whose mean it changes.
        curve: (R, G) share of its training scenes, softened, that the mean of each generation of
            each restart leaves free.
        validated: share of the validation scenes that it solves by the exact check.
    """

    numbers: FloatArray
    component: int
    curve: FloatArray
    validated: float


def _directions(prior: ProMP, posterior: ProMP) -> FloatArray:
    """Return (F, T, 6) rad: what (I - K H) leaves of each function in each joint."""
    functions = torch.from_numpy(detour_functions(_SAMPLES))
    values = prior.basis.values(torch.linspace(0.0, 1.0, _SAMPLES, dtype=torch.float64))
    weights = torch.linalg.lstsq(values, functions.mT).solution.mT
    joints = torch.eye(prior.dimension, dtype=torch.float64)
    # Function by joint by weight (basis first, joint last).
    added = torch.einsum("fk,jd->fjkd", weights, joints).flatten(0, 1).flatten(1)
    latent = prior.whiten(prior.mean + added)
    kept = posterior.whiten_gradient(latent @ (prior.factor / prior.factor.square().sum(0)).mT)
    changed = kept @ posterior.factor.mT
    return prior.trajectory(changed, _SAMPLES).numpy()


def conditioned_course(task: str, problem: Problem, component: int = 0) -> Course | None:
    """Return the conditioned mean of a problem, or None if it is out of a component's reach.

    Args:
        task: whose primitive it is.
        problem: posed by a scene.
        component: of the prior.
    """
    planner = primitive_of(task)
    prior = planner.prior.components()[component]
    with one_thread():
        try:
            branches = condition(prior, problem.constraints, planner.plan_settings)
        except UnreachableError:
            return None
        posterior = max(branches, key=lambda branch: branch[1])[0]
        mean = posterior.trajectory(posterior.mean, _SAMPLES).numpy()
        return Course(problem, mean, _directions(prior, posterior))


def _scale(courses: Sequence[Course]) -> FloatArray:
    """Return (F,) numbers that move a joint by about 1 rad: more where much is conditioned away."""
    if not courses:
        return np.ones(FUNCTIONS * 6)
    moved = [np.abs(course.directions).max(axis=(1, 2)) for course in courses]
    return 1.0 / np.maximum(np.median(moved, axis=0), 1e-2)


class _Scorer:
    """The softened count of free scenes, of a course's detours."""

    def __init__(self, course: Course) -> None:
        self.course = course
        stages = course.problem.stages
        self._parts = [
            (
                stage.body.model,
                PackedObstacles.of(stage.obstacles),
                stage.steps(len(course.mean[::_STRIDE])),
            )
            for stage in stages
            if isinstance(stage.body, RobotBody)
        ]
        self._via = [c for c in course.problem.constraints if isinstance(c, ToolPath)]

    def __call__(self, numbers: FloatArray, softness: float) -> FloatArray:
        """Return (C,) in [0, 1] for detours (C, F)."""
        trajectories = self.course.trajectories(numbers, _STRIDE)
        robot = self.course.problem.robot
        valid = within_joint_limits(trajectories, robot)
        valid &= minimum_duration(trajectories, robot.velocity) <= 15.0
        for constraint in self._via:
            valid &= constraint.missed(trajectories) <= 0.0
        clearance = np.full(len(numbers), -_FLOOR)
        for model, obstacles, steps in self._parts:
            open_ = np.flatnonzero(valid & (clearance > _FLOOR))
            part = trajectories[open_, steps]
            found = sampled_clearance(part, model, obstacles, _FLOOR, -_FLOOR)
            clearance[open_] = np.minimum(clearance[open_], found)
        score = 1.0 / (1.0 + np.exp(-(clearance - _BETWEEN) / softness))
        return np.where(valid & (clearance > _FLOOR), score, 0.0)


def _score(scorers: Sequence[_Scorer], numbers: FloatArray, softness: float) -> FloatArray:
    return np.mean([scorer(numbers, softness) for scorer in scorers], axis=0)


def detours_free(courses: Sequence[Course | None], numbers: FloatArray, task: str) -> BoolArray:
    """Return (C, N) whether detours (C, F) solve each of N scenes, by the exact check.

    Args:
        courses: in the scenes; None where the goal is out of reach.
        numbers: of the detours.
        task: whose settings say what may be missed.
    """
    settings = primitive_of(task).plan_settings
    solved = np.zeros((len(numbers), len(courses)), np.bool_)
    for index, course in enumerate(courses):
        if course is not None:
            trajectories = course.trajectories(numbers)
            solved[:, index] = assess(course.problem, trajectories, settings).good
    return solved


def _improve(
    scorers: Sequence[_Scorer],
    begin: FloatArray,
    scale: FloatArray,
    settings: SearchSettings,
    rng: np.random.Generator,
) -> tuple[list[FloatArray], FloatArray]:
    """Return the means of the last generations of one restart, and its curve (G,)."""
    count = settings.population
    elite = count // 4
    weights = np.log(elite + 0.5) - np.log(np.arange(1, elite + 1))
    weights /= weights.sum()
    mean, covariance = begin, np.diag((0.4 * settings.deviation * scale) ** 2)
    curve, means = np.empty(settings.generations), []
    for generation in range(settings.generations):
        share = generation / max(settings.generations - 1, 1)
        softness = _SOFTNESS[0] * (_SOFTNESS[1] / _SOFTNESS[0]) ** share
        drawn = rng.multivariate_normal(mean, covariance, count, method="eigh")
        drawn[0] = mean
        batch = rng.permutation(len(scorers))[: settings.scenes]
        score = _score([scorers[index] for index in batch], drawn, softness)
        best = np.argsort(-score, kind="stable")[:elite]
        # About the old mean: where the best lie to one side, the spread grows towards them.
        steps = drawn[best] - mean
        mean = mean + weights @ steps
        covariance = 0.6 * covariance + 0.4 * np.einsum("e,ei,ej->ij", weights, steps, steps)
        curve[generation] = score[0]
        means.append(mean)
    return means[-(settings.generations // 4 + 1) :: 2], curve


def learn_detour(
    task: str,
    problems: Sequence[Problem],
    settings: SearchSettings | None = None,
    seed: int = 0,
) -> Detour:
    """Learn the detour that solves the most of a set of training scenes.

    Of a prior with several components (sides) one is chosen: the one whose detour solves more.

    Args:
        task: of the scenes.
        problems: that they pose; the last of them validate.
        settings: of the search.
        seed: of its randomness.

    Raises:
        ValueError: fewer than two problems.
    """
    if len(problems) < 2:
        raise ValueError(f"problems must be at least 2, got {len(problems)}")
    given = settings or SearchSettings()
    found = [
        _of_component(task, problems, component, given, seed)
        for component in range(len(primitive_of(task).prior.components()))
    ]
    return max(found, key=lambda detour: detour.validated)


def _of_component(
    task: str, problems: Sequence[Problem], component: int, settings: SearchSettings, seed: int
) -> Detour:
    rng = np.random.default_rng([seed, component])
    courses = [conditioned_course(task, problem, component) for problem in problems]
    last = max(1, round(settings.validation * len(courses)))
    scorers = [_Scorer(course) for course in courses[:-last] if course is not None]
    scale = _scale([course for course in courses if course is not None])
    # Of all widths: where there is little room, nothing wide leaves a scene free.
    width = settings.deviation * np.geomspace(0.1, 1.0, settings.screened)[:, None]
    numbers = width * scale * rng.standard_normal((settings.screened, len(scale)))
    numbers[0] = 0.0
    screening = scorers[: settings.scenes // 2]
    order = np.argsort(-_score(screening, numbers, _SOFTNESS[0]), kind="stable")
    candidates, curves = [numbers[:1]], []
    for restart in range(settings.restarts):
        means, curve = _improve(scorers, numbers[order[restart]], scale, settings, rng)
        candidates.append(np.array(means))
        curves.append(curve)
    pool = np.concatenate(candidates)
    rates = detours_free(courses[-last:], pool, task).mean(axis=1)
    best = int(rates.argmax())
    return Detour(pool[best], component, np.array(curves), float(rates[best]))
