"""The planners of this package by name, with their settings per task (`settings.json`).

`smp` and the baselines have equal `smooth_std` on a task, so that they start from one prior. The
checkpoints of a stroke hold the pen all along, so a path round an obstacle is short and sharp: it
needs a wider prior, and obstacles that outweigh what holds it. A push holds the middle of the
trajectory, so what comes before and after it is short and must bend more sharply, too; fewer
iterations, of longer steps, are enough then. On both, `smp` has a prior of a shorter length scale
over a finer basis than the paper's 15 functions; the baselines, whose draws keep the spread of the
prior wherever it is not needed, have not.

Where only the mean of a Gaussian gives way, draws around it that keep the prior's spread need room:
on every task (`"*"`), `prompt_o` has a larger weight of obstacles, and `promp_diff` a larger margin
and a wider edge of the map. The other settings of the baselines were the best of a few on the
scenes of before the tasks were made anew: of settings within two points of the highest share of
particles that succeed, the one nearest to the defaults.
`scripts/tune_methods.py` searches the settings of all methods with one budget.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import cache, partial
from importlib import resources
from types import MappingProxyType
from typing import Any, Protocol

from smp_gym.arrays import shown
from smp_gym.datasets.demonstrations import Demonstrations
from smp_planner.adaptation import ADAPTATIONS
from smp_planner.planners.bump_planner import LEARNED, BumpPlanner
from smp_planner.planners.primitive_planner import PrimitivePlanner
from smp_planner.planners.rrt_connect.planner import RRTConnectPlanner
from smp_planner.planning.problem import Planner
from smp_planner.planning.settings import PlanSettings, PriorSettings

__all__ = ["PLANNERS", "ConfiguredPlanner", "learned_from", "make_planner", "task_settings"]


class ConfiguredPlanner(Planner, Protocol):
    """A planner of this package, with its settings."""

    @property
    def settings(self) -> dict[str, Any]:
        """All settings by name, as plain data."""
        ...


def _primitive(
    adaptation: str, demonstrations: Demonstrations, settings: Mapping[str, Any]
) -> ConfiguredPlanner:
    return PrimitivePlanner(demonstrations, adaptation, settings)


def _learned(
    name: str, demonstrations: Demonstrations, settings: Mapping[str, Any]
) -> ConfiguredPlanner:
    return BumpPlanner(demonstrations, name, settings)


PLANNERS: Mapping[str, Callable[[Demonstrations, Mapping[str, Any]], ConfiguredPlanner]]
PLANNERS = MappingProxyType(
    {
        **{name: partial(_primitive, name) for name in ADAPTATIONS},
        "rrt_connect": RRTConnectPlanner,
        **{name: partial(_learned, name) for name in LEARNED},
    }
)
"""Factories of planners by name, from demonstrations and settings."""


@cache
def _settings_file() -> dict[str, dict[str, dict[str, Any]]]:
    text = resources.files(__package__).joinpath("settings.json").read_text(encoding="utf-8")
    return dict(json.loads(text))


def task_settings(name: str, task: str) -> dict[str, Any]:
    """Return the settings that a planner has for a task in place of those of its models.

    They are its own for every task, ``"*"`` in the file, and those of the task. Planners whose
    proposals are learned have the primitive, the costs and the checks of `smp`.
    """
    if name in LEARNED:
        known = {*PriorSettings.model_fields, *PlanSettings.model_fields}
        return {key: value for key, value in task_settings("smp", task).items() if key in known}
    own = _settings_file().get(name, {})
    return {**own.get("*", {}), **own.get(task, {})}


def learned_from(task: str | None, demonstrations: Demonstrations | None) -> Demonstrations:
    """Return what a planner learns from: given demonstrations, or the shipped ones of a task.

    Raises:
        ValueError: neither is given, or they are something else.
        FileNotFoundError: no such task.
    """
    if demonstrations is not None:
        if not isinstance(demonstrations, Demonstrations):
            raise ValueError(
                f"demonstrations must be Demonstrations of a task, got {shown(demonstrations)}"
            )
        return demonstrations
    if task is None:
        raise ValueError("task or demonstrations must be given, got neither")
    return Demonstrations.load(task)


def make_planner(
    name: str,
    task: str | None = None,
    *,
    demonstrations: Demonstrations | None = None,
    settings: Mapping[str, Any] | None = None,
) -> ConfiguredPlanner:
    """Return a planner that has learned from demonstrations.

    Args:
        name: one of `PLANNERS`.
        task: whose shipped demonstrations to learn from.
        demonstrations: what to learn from, in place of the shipped ones.
        settings: settings of the method by name; the rest are those of `task_settings`, or keep
            their defaults.

    Raises:
        ValueError: unknown name, task or setting, a setting out of range, or neither task nor
            demonstrations given.
    """
    if name not in PLANNERS:
        raise ValueError(f"method must be one of {', '.join(PLANNERS)}; got {shown(name)}")
    demonstrations = learned_from(task, demonstrations)
    if settings is not None and not isinstance(settings, Mapping):
        raise ValueError(f"settings must be a mapping by name, got {shown(settings)}")
    chosen = {**task_settings(name, demonstrations.task), **dict(settings or {})}
    return PLANNERS[name](demonstrations, chosen)
