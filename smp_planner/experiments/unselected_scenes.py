"""Methods side by side on scenes that nobody selected: particle sets, and the physics' verdict.

Every method plans once in each scene. Its set is held against independent draws of the posterior
(`arm_posterior`) and against the demonstrations, and some particles of it, drawn at random, are
executed, beside the one that is chosen. What as many draws of the posterior score is the noise
floor. A method that finds no configuration at the goal has a row, too, of a set without particles.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import torch

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.datasets.frozen import load_episodes
from smp_gym.robot.kinematics import UnreachableError
from smp_gym.rollout import rollout
from smp_gym.sampling import sample_scene
from smp_gym.scene import Scene
from smp_gym.suites import Cell
from smp_planner.experiments.arm_posterior import SMC, posterior_draws
from smp_planner.experiments.controls.unadapted import plan_unadapted
from smp_planner.experiments.environments import environment
from smp_planner.experiments.set_measures import (
    PosteriorSample,
    against_posterior,
    of_trajectories,
    total_variation,
)
from smp_planner.experiments.tables import Column, Row
from smp_planner.inference.smc import SMCSettings
from smp_planner.planning.assessment import make_plan, signatures
from smp_planner.planning.conditioning import conditioned_parts
from smp_planner.planning.modes import group
from smp_planner.planning.plan import Plan
from smp_planner.planning.problem import Problem
from smp_planner.policy.planner_policy import PlannerPolicy

__all__ = [
    "COLUMNS",
    "COMPARED",
    "FLOOR",
    "MEAN",
    "METHODS",
    "UNADAPTED",
    "SceneCell",
    "cells_of",
    "measure_scene",
]

FLOOR = "noise floor"
"""Name of the row of as many draws from the posterior itself."""

UNADAPTED = "unadapted"
"""Name of the row of the prior's draws, as many, as wide and with as many tries as `smp` has."""

MEAN = "mean"
"""Name of the row of copies of the prior's mean: what a set without any spread scores."""


def _svgd(inference: str, iterations: int = 100) -> tuple[str, dict[str, Any]]:
    """Return a row of SVGD by itself: with steps of its own, and a prior of one width."""
    own = {"inference": inference, "iterations": iterations, "step_size": None}
    return "smp", own | {"widths": (1.0,)}


METHODS: dict[str, tuple[str, dict[str, Any]]] = {
    "smp": ("smp", {}),
    "one width": ("smp", {"widths": (1.0,)}),
    "50 iterations": ("smp", {"iterations": 50}),
    "no choice": ("smp", {"inference": "no_choice"}),
    "no resampling": ("smp", {"inference": "no_resampling"}),
    "no moves": ("smp", {"inference": "no_moves"}),
    "no repulsion": ("smp", {"inference": "tempered_no_repulsion"}),
    "fading repulsion": ("smp", {"inference": "fading"}),
    "no annealing": ("smp", {"inference": "tempered_no_annealing"}),
    "inverse multi-quadric": ("smp", {"inference": "tempered_imq"}),
    "quick SVGD": _svgd("quick", 50),
    "SVGD": _svgd("svgd"),
    "SVGD, no repulsion": _svgd("no_repulsion"),
    "SVGD, no annealing": _svgd("no_annealing"),
    "SVGD, raw weights": _svgd("raw"),
    "SVGD, med²/log m": _svgd("median_over_log"),
    "SVGD, path kernel": _svgd("path_kernel"),
    "paper": _svgd("paper"),
    "paper, 4 times the iterations": _svgd("paper", 400),
    "cpromp": ("cpromp", {}),
    "cpromp_chance": ("cpromp_chance", {}),
    "prompt_o": ("prompt_o", {}),
    "promp_diff": ("promp_diff", {}),
    "rrt_connect": ("rrt_connect", {}),
    UNADAPTED: ("smp", {}),
    MEAN: ("smp", {}),
}
"""Rows by name: a method with settings on top of the task's own. All have their second tries."""

COLUMNS = (
    Column("task", "Task"),
    Column("method", "Method"),
    Column("solved", "Scenes with a good particle, %", 0),
    Column("good", "Good, %", 1),
    Column("chosen", "Chosen succeeds, %", 0),
    Column("success", "Random ones succeed, %", 1),
    Column("energy", "Energy distance to the posterior, mrad", 0),
    Column("wasserstein", "W1 to it, mrad", 0),
    Column("frechet", "Fréchet, mrad", 0),
    Column("coverage", "Coverage, %", 0),
    Column("variation", "Total variation of classes' shares"),
    Column("goals", "of goals' shares"),
    Column("demonstrations", "W1 to the demonstrations, mrad", 0),
    Column("classes", "Classes", 1),
    Column("entropy", "Entropy, nats"),
    Column("length", "Length, rad", 1),
    Column("jerk", "Smoothness", 1),
    Column("seconds", "Planning, s"),
)
"""Columns of the printed table. Classes and goals are those of good particles, distances of all."""

COMPARED = (
    "good",
    "success",
    "energy",
    "wasserstein",
    "frechet",
    "coverage",
    "variation",
    "goals",
    "demonstrations",
    "entropy",
    "seconds",
)
"""Columns whose paired differences are tested."""


class SceneCell(NamedTuple):
    """Key of the measurements of one scene.

    Attributes:
        task: its name.
        difficulty: of the scene.
        number: seed of the scene; of a frozen list, its place in it.
        frozen: whether it is of the frozen list of the task and difficulty.
        methods: of `METHODS`.
        reference: whether sets are held against draws of the posterior, which takes long.
        executed: how many particles of each set are executed; 0 for none, not even the chosen one.
    """

    task: str
    difficulty: str
    number: int
    frozen: bool
    methods: tuple[str, ...]
    reference: bool
    executed: int


def cells_of(
    tasks: Sequence[str],
    difficulty: str,
    numbers: Iterable[int],
    methods: Sequence[str],
    *,
    frozen: bool = False,
    references: int | None = None,
    executed: int = 0,
) -> list[SceneCell]:
    """Return the cells of scenes of tasks, in turn, so that what is done is as much of each task.

    Args:
        tasks: names.
        difficulty: of all scenes.
        numbers: of the scenes of each task, see `SceneCell`.
        methods: of `METHODS`.
        frozen: see `SceneCell`, as the last argument.
        references: how many scenes of each task, the first ones, are held against draws of the
            posterior; all by default.
        executed: particles of each set.
    """
    return [
        SceneCell(
            task,
            difficulty,
            number,
            frozen,
            tuple(methods),
            references is None or place < references,
            executed,
        )
        for (place, number), task in product(list(enumerate(numbers)), tasks)
    ]


def _scene(cell: SceneCell) -> Scene:
    if cell.frozen:
        return load_episodes(Cell(cell.task, cell.difficulty))[cell.number].scene
    return sample_scene(cell.task, cell.difficulty, cell.number)


@lru_cache(maxsize=len(METHODS))
def _policy(name: str, task: str) -> PlannerPolicy:
    method, settings = METHODS[name]
    return PlannerPolicy.make(method, task, settings=settings)


def measure_scene(cell: SceneCell, smc: SMCSettings = SMC) -> list[Row]:
    """Plan a scene with each method and return their rows; None stands for what is not known.

    Args:
        cell: scene and methods.
        smc: how to draw from the posterior, see `posterior_draws`.
    """
    torch.set_num_threads(1)
    scene = _scene(cell)
    env = environment(cell.task, cell.difficulty)
    observation, _ = env.reset(options={"scene": scene})
    shown = list(_policy("smp", cell.task).demonstrations.configurations)
    problem = _policy("smp", cell.task).problem(observation)
    sample = _sample(cell, problem, smc) if cell.reference else None
    rows: list[Row] = []
    if sample is not None:
        every = np.ones(len(sample.floor), np.bool_)
        rows.append(_row(cell, FLOOR, problem, sample.floor, every, sample, shown))
    for name in cell.methods:
        policy = _policy(name, cell.task)
        plan = _plan(name, policy, policy.problem(observation))
        if plan is None:
            empty = np.empty((0, 0, problem.body.dimension))
            found = _row(cell, name, problem, empty, np.empty(0, np.bool_), sample, shown)
            rows.append(found | {"chosen": 0.0, "success": 0.0} if cell.executed else found)
            continue
        found = _row(cell, name, problem, plan.trajectories, plan.good, sample, shown)
        if cell.executed:
            found |= _executed(cell, policy, plan, scene)
        rows.append(found | {"seconds": plan.planning_time if plan.timings else None})
    return rows


def _sample(cell: SceneCell, problem: Problem, smc: SMCSettings) -> PosteriorSample | None:
    planner: Any = _policy("smp", cell.task).planner
    settings = planner.plan_settings
    draws, others = (
        posterior_draws(
            planner.prior, problem, settings, np.random.default_rng([cell.number, run]), smc
        )
        for run in (0, 1)
    )
    rng = np.random.default_rng(cell.number)
    return PosteriorSample.of(draws, others, settings.particles, rng)


def _plan(name: str, policy: PlannerPolicy, problem: Problem) -> Plan | None:
    """Return the plan of a row; None if the goal is out of reach."""
    try:
        if name == UNADAPTED:
            return plan_unadapted(policy.task, problem)
        if name == MEAN:
            return _copies_of_the_mean(policy.planner, problem)
        (plan,) = policy.planner.plan([problem])
    except UnreachableError:
        return None
    return plan if len(plan.trajectories) else None


def _copies_of_the_mean(planner: Any, problem: Problem) -> Plan:
    settings = planner.plan_settings
    part = conditioned_parts(planner.prior, problem, settings)[0]
    mean = part.primitive.trajectory(part.primitive.mean, settings.samples).numpy()
    copies = np.repeat(mean[None], settings.particles, axis=0)
    return make_plan(problem, copies, {"prior": np.zeros(len(copies))}, settings)


def _executed(cell: SceneCell, policy: PlannerPolicy, plan: Plan, scene: Scene) -> dict[str, float]:
    """Return the success, %, of the chosen particle and of some at random, in the physics."""
    env, count = environment(cell.task, cell.difficulty), len(plan.trajectories)
    rng = np.random.default_rng([cell.number, 5])
    drawn = rng.choice(count, min(cell.executed, count), replace=False)
    chosen, *others = (
        rollout(env, policy.track(plan, int(particle)), scene=scene).success
        for particle in (plan.chosen, *drawn)
    )
    return {"chosen": 100.0 * float(chosen), "success": 100.0 * float(np.mean(others))}


def _row(
    cell: SceneCell,
    name: str,
    problem: Problem,
    paths: FloatArray,
    good: BoolArray,
    sample: PosteriorSample | None,
    demonstrations: Sequence[FloatArray],
) -> dict[str, str | float | None]:
    classes = signatures(problem, paths[good]) if good.any() else None
    modes = None if classes is None else group(classes)
    row: dict[str, str | float | None] = {column.name: None for column in COLUMNS}
    row |= {
        "task": cell.task,
        "method": name,
        "seed": float(cell.number),
        "solved": 100.0 * float(good.any()),
        "good": 100.0 * float(good.mean()) if len(good) else 0.0,
        "classes": 0.0 if modes is None else float(modes.count),
        "entropy": 0.0 if modes is None else modes.entropy,
    }
    if len(paths) > 1:
        row |= of_trajectories(paths, demonstrations)
        if sample is not None:
            row |= against_posterior(paths, sample)
    if classes is not None and sample is not None:
        drawn = signatures(problem, sample.draws)
        row["variation"] = total_variation(classes, drawn)
        # The first number of a signature is that of the goal.
        row["goals"] = total_variation(classes[:, :1], drawn[:, :1])
    return row
