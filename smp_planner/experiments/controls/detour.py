"""The fixed detour: one detour on the conditioned mean for all scenes, which looks at none.

A policy that is blind to obstacles: the primitive is conditioned as `smp` conditions it, and to its
mean one and the same detour is added in every scene, three smooth functions of the phase for each
joint, 18 numbers. It is learned on other scenes by a search over these numbers (cross-entropy
method with full covariance, rank-weighted as in Hansen 2016, arXiv:1604.00772, several restarts)
whose objective is how many scenes the detour leaves free. How a detour changes the conditioned
mean, `smp_planner.planning.bumps` says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.sampling.blind_detours import FUNCTIONS, detour_functions
from smp_planner.agents.posed_scenes import primitive_of
from smp_planner.planning.assessment import assess
from smp_planner.planning.bumps import BumpedMean, SoftenedCheck, mean_with_functions, scale_of
from smp_planner.planning.problem import Problem

__all__ = [
    "Detour",
    "SearchSettings",
    "conditioned_course",
    "detours_free",
    "learn_detour",
]

_SAMPLES = 200
_CHECKED = 40
"""Samples of a trajectory, and how many the search looks at."""

_FLOOR = -0.03
_SOFTNESS = (0.015, 0.003)
"""Metres: least clearance told apart, softness of the objective in the first and last generation.
"""


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


def conditioned_course(task: str, problem: Problem, component: int = 0) -> BumpedMean | None:
    """Return the conditioned mean of a problem, or None if it is out of a component's reach.

    Args:
        task: whose primitive it is.
        problem: posed by a scene.
        component: of the prior.
    """
    planner = primitive_of(task)
    prior = planner.prior.components()[component]
    return mean_with_functions(prior, problem, planner.plan_settings, detour_functions(_SAMPLES))


class _Scorer:
    """The softened count of free scenes, of a course's detours."""

    def __init__(self, course: BumpedMean) -> None:
        self.course = course.resampled(_CHECKED)
        self._check = SoftenedCheck(course.problem, _CHECKED, _FLOOR)

    def __call__(self, numbers: FloatArray, softness: float) -> FloatArray:
        """Return (C,) in [0, 1] for detours (C, F)."""
        return self._check.score(self.course.trajectories(numbers), softness)


def _score(scorers: Sequence[_Scorer], numbers: FloatArray, softness: float) -> FloatArray:
    return np.mean([scorer(numbers, softness) for scorer in scorers], axis=0)


def detours_free(courses: Sequence[BumpedMean | None], numbers: FloatArray, task: str) -> BoolArray:
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
    known = [course for course in courses if course is not None]
    scale = scale_of(known) if known else np.ones(FUNCTIONS * 6)
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
