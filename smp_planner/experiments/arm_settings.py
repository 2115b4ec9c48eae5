"""Settings of Stein variational gradient descent side by side, on scenes of the tasks.

Nothing is executed: what is compared are whole sets of particles, by the planners' exact check.
Particles are *good* if they are collision-free, executable within the joint limits and
pass all via-points.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from itertools import product
from typing import Any, NamedTuple

import gymnasium
import torch

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.arrays import FloatArray
from smp_planner.benchmark.episodes import environment_id
from smp_planner.benchmark.metrics import compare, resample
from smp_planner.experiments.paths import diversity
from smp_planner.experiments.tables import Column, Row
from smp_planner.planners import make_planner
from smp_planner.planning.problem import Problem
from smp_planner.policy.planner_policy import PlannerPolicy

__all__ = [
    "COLUMNS",
    "COMPARED_SETTINGS",
    "PRIOR_WIDTHS",
    "Cell",
    "cells_of",
    "environment",
    "measure_cell",
]


def _of(inference: str, iterations: int = 100) -> dict[str, Any]:
    return {
        "inference": inference,
        "iterations": iterations,
        "step_size": None,
        "widths": (1.0,),
    }


COMPARED_SETTINGS: dict[str, dict[str, Any]] = {
    "tempered": {},
    "quick": {"inference": "quick", "step_size": None, "widths": (1.0,)},
    "default": _of("default"),
    "paper": _of("paper"),
    "paper, 4 times the iterations": _of("paper", 400),
    "raw weights": _of("raw"),
    "med²/log m": _of("median_over_log"),
    "inverse multi-quadric": _of("imq"),
    "path kernel": _of("path_kernel"),
    "no annealing": _of("no_annealing"),
    "cyclic annealing": _of("cyclic"),
    "no repulsion": _of("no_repulsion"),
}
"""Compared variants, by the name in the table; settings of `smp` on top of the task's own, which
are "tempered". "quick" has their iterations; all others change one thing of "default", and have its
iterations. These have the prior of one width.

Without repulsion each particle ascends its own gradient: independent restarts."""

PRIOR_WIDTHS: dict[str, float] = {"usual": 1.0, "narrow": 0.5}
"""Factor of the standard deviation that is added to what the demonstrations teach, `smooth_std`."""

COLUMNS = (
    Column("task", "Task"),
    Column("prior", "Prior"),
    Column("variant", "Setting"),
    Column("solved", "Scenes with a good particle, %", 0),
    Column("free", "Free, %", 1),
    Column("executable", "Executable, %", 1),
    Column("good", "Good, %", 1),
    Column("wasserstein", "W1, mm", 1),
    Column("frechet", "Fréchet, mm", 1),
    Column("mmd", "MMD", 3),
    Column("modes", "Modes", 1),
    Column("entropy", "Entropy, nats"),
    Column("diversity", "Diversity, mm", 1),
    Column("seconds", "Planning, s"),
)
"""Columns of the printed table. Similarity, modes and diversity are those of the good particles."""

_REFERENCE_SIZE = 400


class Cell(NamedTuple):
    """Key of one measurement.

    Attributes:
        task: its name.
        prior: one of `PRIOR_WIDTHS`.
        variant: one of `COMPARED_SETTINGS`.
        difficulty: of the scene.
        seed: of the scene.
    """

    task: str
    prior: str
    variant: str
    difficulty: str
    seed: int


def cells_of(
    tasks: Sequence[str], priors: Sequence[str], difficulty: str, seeds: Iterable[int]
) -> list[Cell]:
    """Return the measurements of all variants in scenes of tasks.

    Scenes stand before priors and variants, so that one worker draws each scene once; what is next
    to each other in a scene differs by its variant only.
    """
    return [
        Cell(task, prior, variant, difficulty, seed)
        for task, seed, prior, variant in product(tasks, seeds, priors, COMPARED_SETTINGS)
    ]


@lru_cache(maxsize=1)
def environment(task: str, difficulty: str) -> gymnasium.Env[Any, Any]:
    """Return the environment of a task and a difficulty, made once for scenes in a row."""
    return gymnasium.make(environment_id(task), difficulty=difficulty)


@lru_cache(maxsize=64)
def _policy(task: str, prior: str, method: str, variant: str) -> PlannerPolicy:
    own: dict[str, Any] = dict(COMPARED_SETTINGS[variant]) | {"retries": 0}
    usual = make_planner("smp", task).settings["smooth_std"]
    own["smooth_std"] = usual * PRIOR_WIDTHS[prior]
    if method == "promp":
        own = {"smooth_std": own["smooth_std"], "particles": _REFERENCE_SIZE}
    return PlannerPolicy.make(method, task, settings=own)


@lru_cache(maxsize=4)
def _reference(task: str, prior: str, difficulty: str, seed: int) -> FloatArray:
    """Return draws (R, T, 3) m of the primitive conditioned on the scene's start and goal."""
    policy = _policy(task, prior, "promp", "default")
    problem = _problem(policy, task, difficulty, seed)
    (plan,) = policy.planner.plan([problem])
    return _paths(problem, plan.trajectories)


def _problem(policy: PlannerPolicy, task: str, difficulty: str, seed: int) -> Problem:
    observation, _ = environment(task, difficulty).reset(seed=seed)
    return policy.problem(observation)


def _paths(problem: Problem, trajectories: FloatArray) -> FloatArray:
    """Return the paths (P, T, 3) m of the carried point."""
    return problem.robot.carried_points(trajectories, problem.goals[0].point)[0]


def measure_cell(cell: Cell) -> Row:
    """Plan once and return what is measured of the set; None where no particle is good."""
    torch.set_num_threads(1)
    policy = _policy(cell.task, cell.prior, "smp", cell.variant)
    problem = _problem(policy, cell.task, cell.difficulty, cell.seed)
    (plan,) = policy.planner.plan([problem])
    good = plan.good
    row: dict[str, str | float | None] = {
        "task": cell.task,
        "prior": cell.prior,
        "variant": cell.variant,
        "seed": float(cell.seed),
        "solved": 100.0 * float(good.any()),
        "free": 100.0 * float(plan.collision_free.mean()),
        "executable": 100.0 * float(plan.executable.mean()),
        "good": 100.0 * float(good.mean()),
        "seconds": plan.planning_time,
    }
    measured = ("wasserstein", "frechet", "mmd", "modes", "entropy", "diversity")
    if not good.any():
        return row | dict.fromkeys(measured)
    paths = _paths(problem, plan.trajectories[good])
    reference = _reference(cell.task, cell.prior, cell.difficulty, cell.seed)
    similarity = compare(paths, reference)
    return row | {
        "wasserstein": 1e3 * similarity.wasserstein,
        "frechet": 1e3 * similarity.frechet,
        "mmd": similarity.mmd,
        "modes": float(plan.modes.count),
        "entropy": plan.modes.entropy,
        "diversity": 1e3 * diversity(resample(paths)) if len(paths) > 1 else None,
    }
