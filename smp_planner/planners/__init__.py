"""The methods, by the names under which the command line knows them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from smp_gym.demonstrations import Demonstrations
from smp_planner.planners.base import PlannerModel
from smp_planner.planners.promp import ProMPPlanner
from smp_planner.planners.rrt_connect import RRTConnectPlanner
from smp_planner.planners.smp import SMPPlanner

__all__ = ["PLANNERS", "PlannerModel", "make_planner"]

PLANNERS: dict[str, type[PlannerModel]] = {
    cls.name: cls for cls in (SMPPlanner, ProMPPlanner, RRTConnectPlanner)
}
"""Planner classes by name."""


TASK_SETTINGS: dict[tuple[str, str], dict[str, Any]] = {
    ("smp", "DrawS"): {
        "smooth_std": 0.4,
        "obstacle_weight": 10.0,
        "via_share": 0.25,
        "retries": 2,
    },
    ("smp", "PushLiftBox"): {
        "smooth_std": 0.6,
        "obstacle_weight": 20.0,
        "iterations": 70,
        "retries": 2,
    },
}
"""Settings that a method (first) has for a task (second) in place of its own defaults.

The checkpoints of a stroke hold the pen all along, so a way round an obstacle is short and sharp:
it needs more freedom, and obstacles that outweigh what holds it. A push holds the middle of the
way, so the ways before and after it are short and must bend more sharply, too; fewer iterations do
then."""


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
