"""One repetition of Table II: a plan made, measured, and every particle of it executed."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import torch

from smp_gym.arrays import FloatArray
from smp_gym.robot.kinematics import UnreachableError
from smp_gym.rollout import Rollout, rollout
from smp_gym.scene import TASKS
from smp_planner.benchmark.metrics import (
    COMPARED_SAMPLES,
    Metrics,
    compare,
    path_lengths,
    success_rates,
)
from smp_planner.experiments.environments import environment
from smp_planner.experiments.table_two.scenes import load_scenes, prior_settings, shared_prior
from smp_planner.movement_primitives import ProMP
from smp_planner.movement_primitives.mixture import shared_out
from smp_planner.planning.assessment import free_waypoints
from smp_planner.planning.conditioning import condition
from smp_planner.planning.modes import group
from smp_planner.planning.plan import Plan
from smp_planner.planning.problem import Problem
from smp_planner.planning.settings import PlanSettings
from smp_planner.policy.planner_policy import PlannerPolicy

__all__ = [
    "FLOOR",
    "METHODS",
    "PARTICLES",
    "REFERENCE_DRAWS",
    "RepetitionKey",
    "RepetitionRow",
    "methods_of",
    "play_repetition",
]

PARTICLES = 42
"""Trajectories of each repetition, as in the paper."""

REFERENCE_DRAWS = 1000
"""Trajectories of the unadapted primitive with which all are compared."""

FLOOR = "floor"
"""Name of the rows in which a fresh draw of the unadapted primitive takes the place of a plan."""

_MATCHED = "_matched"
_BASELINES = ("cpromp", "prompt_o", "promp_diff")
METHODS = (
    FLOOR,
    "promp",
    "smp",
    *_BASELINES,
    *(name + _MATCHED for name in _BASELINES),
    "rrt_connect",
)
"""Rows of each task; those that end in ``_matched`` keep one Gaussian for all demonstrations, its
moments matched to them, as the paper's baselines do, and are of tasks with several modes only."""

SAMPLES = 200
"""Samples of each trajectory, as in plans, at which lengths and smoothness are measured."""

_UNREACHABLE = "goal out of reach"


@dataclass(frozen=True, order=True)
class RepetitionKey:
    """Identifier of a repetition.

    Attributes:
        repetition: seed of the policy.
        task: one of `smp_gym.scene.TASKS`.
        method: one of `METHODS`.
    """

    repetition: int
    task: str
    method: str


@dataclass(frozen=True)
class RepetitionRow:
    """Record of a repetition; P particles. Lists are empty in rows of the noise floor.

    Similarity and lengths are those of the paths of the carried point (the object's centre or the
    pen's tip), in metres, against `REFERENCE_DRAWS` draws of the unadapted primitive: conditioned
    on start, goal and via-points of the scene, with the added covariance that all methods of
    the task start from.

    Attributes:
        repetition: see `RepetitionKey`, as the next two.
        task: name of the task.
        method: name of the method.
        success: P, whether the physics judged the executed particle a success.
        causes: P, why it failed; empty after a success.
        steps: P, environment steps.
        planned: P, whether the planner's own check finds it collision-free, executable and ending
            in the goal.
        lengths: P, m, of the planned path.
        free_waypoints: share of the collision-free configurations of all trajectories together.
        all: similarity of all particles; None if there are none.
        successful: of those that succeeded in the physics; None if none did.
        floor: of as many fresh draws of the primitive as there are successful particles.
        modes: number of classes of the successful ones, see `Plan.signatures`.
        entropy: of their shares, nats.
        planning_time: s.
    """

    repetition: int
    task: str
    method: str
    success: tuple[bool, ...] = ()
    causes: tuple[str, ...] = ()
    steps: tuple[int, ...] = ()
    planned: tuple[bool, ...] = ()
    lengths: tuple[float, ...] = ()
    free_waypoints: float | None = None
    all: Metrics | None = None
    successful: Metrics | None = None
    floor: Metrics | None = None
    modes: int = 0
    entropy: float = 0.0
    planning_time: float = 0.0

    @property
    def key(self) -> RepetitionKey:
        """Identifier of the repetition."""
        return RepetitionKey(self.repetition, self.task, self.method)


def methods_of(task: str, methods: Sequence[str] = METHODS) -> list[str]:
    """Return those of `methods` that a task has rows of."""
    several = len(shared_prior(task).mixture.components) > 1
    return [name for name in methods if several or not name.endswith(_MATCHED)]


def play_repetition(key: RepetitionKey) -> RepetitionRow:
    """Play one repetition; environment and planners are made once per process."""
    if key.method == FLOOR:
        floor = _fresh(key.task, PARTICLES, key.repetition)
        return RepetitionRow(key.repetition, key.task, key.method, all=floor)
    policy = _policy(key.task, key.method)
    policy.set_random_seed(key.repetition)
    env = environment(key.task, "medium")
    observation, _ = env.reset(options={"scene": load_scenes()[key.task]})
    problem = policy.problem(observation)
    try:
        (plan,) = policy.planner.plan([problem])
    except UnreachableError:
        return _without_plan(key)
    tracks = [policy.track(plan, particle) for particle in range(len(plan.trajectories))]
    scene = load_scenes()[key.task]
    return _measured(key, problem, plan, [rollout(env, track, scene=scene) for track in tracks])


def _without_plan(key: RepetitionKey) -> RepetitionRow:
    """Return the row of a method that finds no configuration at any goal."""
    return RepetitionRow(
        key.repetition,
        key.task,
        key.method,
        success=(False,) * PARTICLES,
        causes=(_UNREACHABLE,) * PARTICLES,
        steps=(0,) * PARTICLES,
        planned=(False,) * PARTICLES,
        lengths=(0.0,) * PARTICLES,
    )


def _measured(
    key: RepetitionKey, problem: Problem, plan: Plan, played: Sequence[Rollout]
) -> RepetitionRow:
    paths = problem.robot.carried_points(plan.trajectories, problem.goals[0].point)[0]
    success = np.array([one.success for one in played])
    reached = plan.goal_error <= PlanSettings().sigma
    free = free_waypoints(problem, plan.trajectories)
    count = int(success.sum())
    reference = _reference(key.task)
    successful = floor = None
    modes = None
    if count:
        successful = compare(paths[success], reference)
        floor = _fresh(key.task, count, key.repetition)
        modes = group(plan.signatures[success])
    return RepetitionRow(
        key.repetition,
        key.task,
        key.method,
        success=tuple(success.tolist()),
        causes=tuple(_cause(one.info) for one in played),
        steps=tuple(one.steps for one in played),
        planned=tuple(plan.good.tolist()),
        lengths=tuple(path_lengths(paths).tolist()),
        free_waypoints=success_rates(free, reached).waypoints,
        all=compare(paths, reference),
        successful=successful,
        floor=floor,
        modes=0 if modes is None else modes.count,
        entropy=0.0 if modes is None else modes.entropy,
        planning_time=plan.planning_time,
    )


def _cause(info: dict[str, Any]) -> str:
    contact = " – ".join(info["collision"] or ())
    return f"{info['failure']}: {contact}" if contact else info["failure"]


@lru_cache(maxsize=len(TASKS) * len(METHODS))
def _policy(task: str, method: str) -> PlannerPolicy:
    """Return a policy after one unrecorded plan, so that no row times a compilation."""
    name = method.removesuffix(_MATCHED)
    settings: dict[str, Any] = {"particles": PARTICLES}
    if name != "rrt_connect":
        settings |= prior_settings(task).model_dump()
    if method.endswith(_MATCHED):
        settings["per_component"] = False
    policy = PlannerPolicy.make(name, task, settings=settings)
    observation, _ = environment(task, "medium").reset(options={"scene": load_scenes()[task]})
    with suppress(UnreachableError):
        policy.plan(observation)
    return policy


class _Conditioned(NamedTuple):
    """The unadapted primitive of a task's scene: components, their shares, and the problem."""

    components: tuple[ProMP, ...]
    shares: tuple[float, ...]
    problem: Problem


@lru_cache(maxsize=len(TASKS))
def _conditioned(task: str) -> _Conditioned:
    prior = shared_prior(task)
    observation, _ = environment(task, "medium").reset(options={"scene": load_scenes()[task]})
    problem = _policy(task, "promp").problem(observation)
    return _Conditioned(
        tuple(
            condition(component, problem.constraints, PlanSettings())[0][0]
            for component in prior.components()
        ),
        tuple(prior.used.shares.tolist()),
        problem,
    )


def _draws(task: str, count: int, number: int, samples: int) -> FloatArray:
    """Return (count, samples, 3) m, paths of the carried point under the unadapted primitive.

    Args:
        task: name of the task.
        count: how many draws.
        number: of the set of draws; 0 is the reference.
        samples: at equal steps of phase.
    """
    conditioned = _conditioned(task)
    rng = np.random.default_rng([number, TASKS.index(task)])
    paths = []
    counts = shared_out(count, conditioned.shares)
    for component, share in zip(conditioned.components, counts, strict=True):
        if share:
            latent = torch.from_numpy(rng.standard_normal((share, component.rank)))
            trajectories = component.trajectory(component.unwhiten(latent), samples)
            problem = conditioned.problem
            paths.append(
                problem.robot.carried_points(trajectories.numpy(), problem.goals[0].point)[0]
            )
    return np.concatenate(paths)


@lru_cache(maxsize=len(TASKS))
def _reference(task: str) -> FloatArray:
    """Return (1000, 50, 3) m, what the trajectories of all methods are compared with."""
    return _draws(task, REFERENCE_DRAWS, 0, COMPARED_SAMPLES)


def _fresh(task: str, count: int, repetition: int) -> Metrics:
    """Return the metrics of a fresh draw: the noise floor of so many trajectories."""
    return compare(_draws(task, count, 1 + repetition, SAMPLES), _reference(task))
