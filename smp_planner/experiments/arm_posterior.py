"""Particle sets of methods against the posterior, on unselected scenes of the tasks.

The reference are draws from p(w | good, start, goal): sequential Monte Carlo under the prior and
the costs of `smp`, all components, branches and widths of the prior weighed by their evidence, of
which those are kept that the exact check finds good. Nothing is executed. What as many independent
draws score is the noise floor; a second run of the reference gives it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import torch

from smp_gym.arrays import FloatArray
from smp_planner.adaptation import Runs
from smp_planner.benchmark.metrics import energy_distance, resample
from smp_planner.experiments.arm_settings import environment
from smp_planner.experiments.tables import Column, Row
from smp_planner.inference.smc import SMCSettings, sample_posterior
from smp_planner.planning.assessment import assess, signatures
from smp_planner.planning.modes import group
from smp_planner.planning.pipeline import Part, conditioned_parts
from smp_planner.planning.prior import Prior
from smp_planner.planning.problem import Problem
from smp_planner.planning.settings import PlanSettings
from smp_planner.planning.target import SceneTarget
from smp_planner.policy.planner_policy import PlannerPolicy
from smp_planner.torch_threads import one_thread

__all__ = [
    "COLUMNS",
    "FLOOR",
    "METHODS",
    "PosteriorCell",
    "cells_of",
    "measure_cell",
    "posterior_draws",
]

FLOOR = "noise floor"
"""Name of the row of as many draws from the posterior itself."""

METHODS: dict[str, tuple[str, dict[str, Any]]] = {
    "smp": ("smp", {}),
    "smp, one width": ("smp", {"widths": (1.0,)}),
    "no choice": ("smp", {"inference": "no_choice"}),
    "no resampling": ("smp", {"inference": "no_resampling"}),
    "no moves": ("smp", {"inference": "no_moves"}),
    "quick SVGD": ("smp", {"inference": "quick", "widths": (1.0,)}),
    "SVGD": ("smp", {"inference": "default", "iterations": 100, "widths": (1.0,)}),
    "paper": ("smp", {"inference": "paper", "iterations": 100, "widths": (1.0,)}),
    "cpromp": ("cpromp", {}),
    "prompt_o": ("prompt_o", {}),
    "promp_diff": ("promp_diff", {}),
    "rrt_connect": ("rrt_connect", {}),
}
"""Rows by name: a method with settings on top of the task's own. All have their second tries."""

COLUMNS = (
    Column("task", "Task"),
    Column("method", "Method"),
    Column("solved", "Scenes with a good particle, %", 0),
    Column("good", "Good, %", 1),
    Column("energy", "Energy distance to the posterior, mrad", 0),
    Column("classes", "Classes", 1),
    Column("entropy", "Entropy, nats"),
    Column("seconds", "Planning, s"),
)
"""Columns of the printed table. Classes are those of the good particles."""

_SMC = SMCSettings(particles=300, moves=10, last_moves=40)


class PosteriorCell(NamedTuple):
    """Key of the measurements of one scene.

    Attributes:
        task: its name.
        difficulty: of the scene.
        seed: of the scene.
        methods: of `METHODS`.
    """

    task: str
    difficulty: str
    seed: int
    methods: tuple[str, ...]


def cells_of(
    tasks: Sequence[str], difficulty: str, seeds: Iterable[int], methods: Sequence[str]
) -> list[PosteriorCell]:
    """Return the cells of scenes of tasks."""
    return [
        PosteriorCell(task, difficulty, seed, tuple(methods))
        for task, seed in product(tasks, seeds)
    ]


def posterior_draws(
    prior: Prior,
    problem: Problem,
    settings: PlanSettings,
    rng: np.random.Generator,
    smc: SMCSettings = _SMC,
) -> FloatArray:
    """Return good draws (R, T, D) rad from the posterior of a problem.

    Args:
        prior: of a planner.
        problem: to be solved.
        settings: its costs, and the widths of the prior.
        rng: source of all randomness.
        smc: how to draw, for each part; R is at most the number of its particles.
    """
    with one_thread():
        target = SceneTarget(problem, settings)
        # As many particles as make a share of each part come out right.
        shares = settings.model_copy(update={"particles": 1000})
        parts = conditioned_parts(prior, problem, shares)
        latent, evidence = [], []
        for part in parts:
            draws, log_evidence = _part_draws(part, target, settings, rng, smc)
            latent.append(draws)
            evidence.append(np.log(len(part.latent)) + log_evidence)
        weights = np.exp(np.array(evidence) - max(evidence))
        counts = rng.multinomial(smc.particles, weights / weights.sum())
        drawn = []
        for part, draws, count in zip(parts, latent, counts, strict=True):
            chosen = torch.from_numpy(draws[rng.choice(len(draws), count, replace=False)])
            drawn.append(
                part.primitive.trajectory(part.primitive.unwhiten(chosen), settings.samples)
            )
        trajectories = torch.cat(drawn).numpy()
        return np.asarray(trajectories[assess(problem, trajectories, settings).good])


def _part_draws(
    part: Part,
    target: SceneTarget,
    settings: PlanSettings,
    rng: np.random.Generator,
    smc: SMCSettings,
) -> tuple[FloatArray, float]:
    """Return draws (R, r) of a part's posterior in whitened coordinates, and its log-evidence."""
    runs = Runs.of([part.primitive], settings.planning_steps)

    def log_likelihood(latent: FloatArray) -> FloatArray:
        paths = runs.latent_trajectories(torch.from_numpy(latent)[None])[0].numpy()
        return -target.weighted_sum(paths)

    found = sample_posterior(log_likelihood, part.primitive.rank, rng, smc)
    return found.particles, found.log_evidence


@lru_cache(maxsize=len(METHODS))
def _policy(name: str, task: str) -> PlannerPolicy:
    method, settings = METHODS[name]
    return PlannerPolicy.make(method, task, settings=settings)


def measure_cell(cell: PosteriorCell, smc: SMCSettings = _SMC) -> list[Row]:
    """Plan a scene with each method and return their rows; no energy where no draw is good.

    Args:
        cell: scene and methods.
        smc: how to draw from the posterior, see `posterior_draws`.
    """
    torch.set_num_threads(1)
    observation, _ = environment(cell.task, cell.difficulty).reset(seed=cell.seed)
    planner: Any = _policy("smp", cell.task).planner
    problem = _policy("smp", cell.task).problem(observation)
    settings = planner.plan_settings
    reference, second = (
        posterior_draws(
            planner.prior, problem, settings, np.random.default_rng([cell.seed, run]), smc
        )
        for run in (0, 1)
    )
    size = min(settings.particles, len(second))
    floor = second[np.random.default_rng(cell.seed).choice(len(second), size, replace=False)]
    rows = [_row(cell, FLOOR, problem, floor, np.ones(size, np.bool_), reference, None)]
    for name in cell.methods:
        policy = _policy(name, cell.task)
        (plan,) = policy.planner.plan([policy.problem(observation)])
        paths, good = np.asarray(plan.trajectories), plan.good
        rows.append(_row(cell, name, problem, paths, good, reference, plan.planning_time))
    return rows


def _row(
    cell: PosteriorCell,
    name: str,
    problem: Problem,
    paths: FloatArray,
    good: np.ndarray,
    reference: FloatArray,
    seconds: float | None,
) -> Row:
    known = len(paths) > 1 and len(reference) > 1
    modes = group(signatures(problem, paths[good])) if good.any() else None
    return {
        "task": cell.task,
        "method": name,
        "seed": float(cell.seed),
        "solved": 100.0 * float(good.any()),
        "good": 100.0 * float(good.mean()) if len(good) else None,
        "energy": (1e3 * energy_distance(resample(paths), resample(reference)) if known else None),
        "classes": None if modes is None else float(modes.count),
        "entropy": None if modes is None else modes.entropy,
        "seconds": seconds,
    }
