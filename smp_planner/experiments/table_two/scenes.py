"""The four scenes of Table II, frozen, and the rule by which they were chosen.

They were drawn before the difficulties were bound to controls: the sampler no longer draws them.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.assets import asset_path
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.sampling import sample_scene
from smp_gym.scene import TASKS, Scene
from smp_planner.benchmark.episodes import environment_id
from smp_planner.benchmark.results_folder import write_json
from smp_planner.planners import task_settings
from smp_planner.planning.assessment import free_waypoints
from smp_planner.planning.conditioning import condition
from smp_planner.planning.prior import Prior, learn_prior
from smp_planner.planning.settings import PlanSettings, PriorSettings
from smp_planner.policy.planner_policy import PlannerPolicy

__all__ = [
    "PRIOR",
    "RULE",
    "SCENES_FILE",
    "choose_scene",
    "load_scenes",
    "shared_prior",
    "write_scenes",
]

SCENES_FILE = "table_two_scenes.json"
"""File of the scenes in the folder ``experiments`` of the packaged data."""

PRIOR: dict[str, Any] = {"basis_functions": 15, "smooth_length_scale": 0.2}
"""Settings of the primitive that all methods share, on every task; 15 is the paper's K."""


def prior_settings(task: str) -> PriorSettings:
    """Return the settings of the prior that all methods share on a task."""
    own = task_settings("smp", task)
    return PriorSettings.model_validate(
        PRIOR | {name: own[name] for name in ("smooth_std",) if name in own}
    )


def shared_prior(task: str) -> Prior:
    """Return the prior that all methods share on a task."""
    demonstrations = Demonstrations.load(task)
    return learn_prior(list(np.array(demonstrations.configurations)), prior_settings(task))


DIFFICULTY = "medium"
MOST_SEEDS = 200
LEAST_SUCCESS_SHARE = 0.1

RULE = (
    f"the first tuning seed of difficulty {DIFFICULTY} in which the mean of the conditioned "
    f"primitive collides, while smp and each baseline, with a component of its own for each mode, "
    f"plans at least {LEAST_SUCCESS_SHARE:.0%} of its particles with success (policy seed 0)"
)
"""Conditions on a scene. Where a method had no successful trajectory, its similarity could not be
compared over those; the rule asks the same of all methods."""

_FORMAT_VERSION = 1


def _mean_collides(prior: Prior, policy: PlannerPolicy, observation: Any) -> bool:
    """Return whether the mean of each component, conditioned on the constraints, collides."""
    problem = policy.problem(observation)
    means = []
    for component in prior.components():
        (posterior, _), *_ = condition(component, problem.constraints, PlanSettings())
        means.append(posterior.trajectory(posterior.mean, 200).numpy())
    return not free_waypoints(problem, np.array(means)).all(axis=1).any()


def choose_scene(task: str, methods: Sequence[str]) -> Scene:
    """Return the scene of a task that `RULE` names.

    Args:
        task: one of `smp_gym.scene.TASKS`.
        methods: of which each must succeed with `LEAST_SUCCESS_SHARE` of its particles.

    Raises:
        RuntimeError: none of the first `MOST_SEEDS` seeds is such a scene.
    """
    torch.set_num_threads(1)
    env = gym.make(environment_id(task), difficulty=DIFFICULTY)
    prior = shared_prior(task)
    policies = [PlannerPolicy.make(method, task, settings=PRIOR) for method in methods]
    try:
        for seed in range(MOST_SEEDS):
            observation, _ = env.reset(seed=seed)
            if _mean_collides(prior, policies[0], observation) and all(
                _share(policy, observation) >= LEAST_SUCCESS_SHARE for policy in policies
            ):
                return sample_scene(task, DIFFICULTY, seed)
    finally:
        env.close()
    raise RuntimeError(f"{task}: none of the first {MOST_SEEDS} seeds is {RULE}")


def _share(policy: PlannerPolicy, observation: Any) -> float:
    """Return the share of particles that succeed by the planner's exact check."""
    plan = policy.plan(observation)
    return float(plan.good.mean())


def write_scenes(scenes: Sequence[Scene], path: Path) -> None:
    """Write scenes and the rule that they were chosen by."""
    content = {
        "format": _FORMAT_VERSION,
        "rule": RULE,
        "scenes": [json.loads(scene.to_json()) for scene in scenes],
    }
    write_json(path, content)


@lru_cache(maxsize=1)
def load_scenes() -> dict[str, Scene]:
    """Return the frozen scene of each task.

    Raises:
        ValueError: the file is damaged.
    """
    path = asset_path("experiments", SCENES_FILE)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["format"] != _FORMAT_VERSION:
            raise ValueError(f"format must be {_FORMAT_VERSION}, got {content['format']!r}")
        scenes = [Scene.model_validate(entry) for entry in content["scenes"]]
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise ValueError(f"{path} does not hold the scenes of Table II: {error}") from error
    by_task = {scene.task: scene for scene in scenes}
    return {task: by_task[task] for task in TASKS if task in by_task}
