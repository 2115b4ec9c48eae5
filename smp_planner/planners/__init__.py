"""The methods, by the names under which the command line knows them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.scene import TASKS
from smp_planner.planners.base import PlannerModel
from smp_planner.planners.cpromp import CProMPPlanner
from smp_planner.planners.promp import ProMPPlanner
from smp_planner.planners.promp_diff import ProMPDiffPlanner
from smp_planner.planners.prompt_o import ProMPTOPlanner
from smp_planner.planners.rrt_connect.planner import RRTConnectPlanner
from smp_planner.planners.smp import SMPPlanner

__all__ = ["PLANNERS", "PlannerModel", "make_planner"]

PLANNERS: dict[str, type[PlannerModel]] = {
    cls.name: cls
    for cls in (
        SMPPlanner,
        ProMPPlanner,
        CProMPPlanner,
        ProMPTOPlanner,
        ProMPDiffPlanner,
        RRTConnectPlanner,
    )
}
"""Planner classes by name."""


_ADAPTING = ("smp", "cpromp", "prompt_o", "promp_diff")

_FREEDOM: dict[str, dict[str, Any]] = {
    "DrawS": {"smooth_std": 0.4, "obstacle_weight": 10.0, "retries": 2},
    "PushLiftBox": {"smooth_std": 0.6, "retries": 2},
}

_ROOMY = {"obstacle_weight": 30.0, "margin": 0.03}

_OWN: dict[tuple[str, str], dict[str, Any]] = {
    ("smp", "DrawS"): {
        "smooth_length_scale": 0.1,
        "basis_functions": 25,
        "via_share": 0.25,
        "retries": 4,
    },
    ("smp", "PushLiftBox"): {
        "smooth_length_scale": 0.14,
        "basis_functions": 20,
        "obstacle_weight": 20.0,
        "iterations": 70,
    },
    ("cpromp", "DrawS"): {"via_share": 0.25},
    ("cpromp", "PushLiftBox"): {"obstacle_weight": 30.0, "margin": 0.02, "iterations": 400},
    ("prompt_o", "Placement"): {**_ROOMY, "rounds": 16},
    ("prompt_o", "DoubleSidedPlacement"): {"obstacle_weight": 3.0},
    ("prompt_o", "DrawS"): {"via_share": 0.0, "obstacle_weight": 30.0},
    ("prompt_o", "PushLiftBox"): _ROOMY,
    ("promp_diff", "Placement"): {"fit_std": 0.05},
    ("promp_diff", "PushLiftBox"): {"fit_std": 0.05},
}

TASK_SETTINGS: dict[tuple[str, str], dict[str, Any]] = {
    (method, task): settings
    for method in _ADAPTING
    for task in TASKS
    if (settings := {**_FREEDOM.get(task, {}), **_OWN.get((method, task), {})})
}
"""Settings that a method (first) has for a task (second) in place of its own defaults.

Freedom is equal for all methods that adapt the primitive, so that they start from one prior.

The checkpoints of a stroke hold the pen all along, so a way round an obstacle is short and sharp:
it needs more freedom, and obstacles that outweigh what holds it. A push holds the middle of the
way, so the ways before and after it are short and must bend more sharply, too; fewer iterations do
then. On both, `smp` has freedom of a shorter length scale over a finer basis than the paper's 15
functions; the baselines, whose draws keep the spread of the prior wherever it is not needed, have
not.

What the baselines have of their own is the best of what `scripts/tune_baselines.py` tries: of
settings within two points of the highest share of particles that succeed, the one nearest to the
defaults, since a firmer one gives up likeness for nothing."""


def make_planner(
    name: str,
    task: str | None = None,
    *,
    demonstrations: Demonstrations | None = None,
    settings: Mapping[str, Any] | None = None,
) -> PlannerModel:
    """Return a planner that has learned from demonstrations.

    Args:
        name: one of `PLANNERS`.
        task: whose shipped demonstrations to learn from.
        demonstrations: what to learn from, in place of the shipped ones.
        settings: settings of the method by name; the rest are those of `TASK_SETTINGS`, or keep
            their defaults.

    Raises:
        ValueError: unknown name, task or setting, a setting out of range, or neither task nor
            demonstrations given.
    """
    if name not in PLANNERS:
        raise ValueError(f"method must be one of {', '.join(PLANNERS)}; got {name!r}")
    if demonstrations is None:
        if task is None:
            raise ValueError("task or demonstrations must be given, got neither")
        demonstrations = Demonstrations.load(task)
    cls = PLANNERS[name]
    chosen = {**TASK_SETTINGS.get((name, demonstrations.task), {}), **dict(settings or {})}
    return cls(demonstrations, cls.Settings.model_validate(chosen))
