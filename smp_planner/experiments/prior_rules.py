"""Rules for the width of the prior: likelihood of demonstrations left out, and what plans come to.

A prior adds a smooth covariance to what a few demonstrations teach (`ProMP.fit`). A rule is a list
of factors of the standard deviation that a task's settings add; the prior is the mixture, in equal
shares, of the primitives with each of them. The leave-one-out likelihood asks how well the prior of
all other demonstrations foretells one; plans ask for room to go round obstacles.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from itertools import product
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import torch
from scipy import stats

from smp_gym.datasets.demonstrations import Demonstrations
from smp_planner.experiments.environments import environment
from smp_planner.experiments.set_measures import of_trajectories
from smp_planner.experiments.tables import Column, Row
from smp_planner.planners import make_planner
from smp_planner.planning.prior import learn_prior
from smp_planner.planning.settings import PriorSettings
from smp_planner.policy.planner_policy import PlannerPolicy

__all__ = ["COLUMNS", "RULES", "RuleCell", "cells_of", "leave_one_out", "measure_rule"]


def _student(degrees: int, nodes: int) -> tuple[float, ...]:
    """Return factors whose mixture is about a Student-t: √(ν / χ²) at equal steps of probability.

    A multivariate t is a mixture of Gaussians, their covariance divided by u ~ χ²_ν / ν.
    """
    middles = (np.arange(nodes) + 0.5) / nodes
    return tuple(np.sqrt(degrees / stats.chi2.ppf(middles[::-1], degrees)).tolist())


RULES: Mapping[str, tuple[float, ...]] = MappingProxyType(
    {
        "a sixteenth": (1.0 / 16.0,),
        "an eighth": (1.0 / 8.0,),
        "a quarter": (1.0 / 4.0,),
        "half": (1.0 / 2.0,),
        "as set": (1.0,),
        "twice": (2.0,),
        "as set and twice": (1.0, 2.0),
        "an eighth and as set": (1.0 / 8.0, 1.0),
        "Student-t": _student(7, 4),
    }
)
"""Factors of the added standard deviation by the name of a rule; the t has as many degrees of
freedom as there are demonstrations."""

COLUMNS = (
    Column("task", "Task"),
    Column("rule", "Added deviation"),
    Column("likelihood", "Left-out log-likelihood, nats a number", 3),
    Column("solved", "Scenes with a good particle, %", 0),
    Column("good", "Good, %", 1),
    Column("demonstrations", "W1 to the demonstrations, mrad", 0),
    Column("seconds", "Planning, s"),
)
"""Columns of the printed table."""


class RuleCell(NamedTuple):
    """Key of one measurement.

    Attributes:
        task: its name.
        rule: one of `RULES`.
        difficulty: of the scene.
        seed: of the scene.
    """

    task: str
    rule: str
    difficulty: str
    seed: int


def cells_of(
    tasks: Sequence[str], rules: Sequence[str], difficulty: str, seeds: Iterable[int]
) -> list[RuleCell]:
    """Return the measurements of rules in scenes of tasks."""
    return [
        RuleCell(task, rule, difficulty, seed) for task, rule, seed in product(tasks, rules, seeds)
    ]


def leave_one_out(
    demonstrations: Sequence[np.ndarray], settings: PriorSettings, factors: Sequence[float]
) -> float:
    """Return the mean log-density of each demonstration under what the others teach.

    Args:
        demonstrations: N arrays (T_j, D), N at least 3.
        settings: of learning; its modes are found anew for each N - 1.
        factors: of `PriorSettings.smooth_std`, positive; a mixture of equal shares.

    Returns:
        Nats a number, of T_j * D numbers each.
    """
    least = min(factors)
    assert isinstance(settings.smooth_std, float)
    base = settings.model_copy(update={"smooth_std": least * settings.smooth_std})
    found = []
    for index, left_out in enumerate(demonstrations):
        prior = learn_prior([*demonstrations[:index], *demonstrations[index + 1 :]], base)
        shares = prior.used.shares.log() - math.log(len(factors))
        joint = [
            share + component.log_likelihood([left_out])[0]
            for factor in factors
            for share, component in zip(shares, prior.components(factor / least), strict=True)
        ]
        found.append(float(torch.logsumexp(torch.stack(joint), 0)) / left_out.size)
    return float(np.mean(found))


def _settings(task: str) -> PriorSettings:
    settings = make_planner("smp", task).settings
    return PriorSettings(**{name: settings[name] for name in PriorSettings.model_fields})


@lru_cache(maxsize=64)
def _likelihood(task: str, rule: str) -> float:
    demonstrations = list(np.array(Demonstrations.load(task).configurations))
    return leave_one_out(demonstrations, _settings(task), RULES[rule])


@lru_cache(maxsize=4)
def _policy(task: str, rule: str) -> PlannerPolicy:
    factors = RULES[rule]
    least, usual = min(factors), _settings(task).smooth_std
    assert isinstance(usual, float)
    own: dict[str, Any] = {
        "smooth_std": least * usual,
        "widths": tuple(factor / least for factor in factors),
        "retries": 0,
    }
    return PlannerPolicy.make("smp", task, settings=own)


def measure_rule(cell: RuleCell) -> Row:
    """Plan a scene with the prior of a rule and return its row."""
    torch.set_num_threads(1)
    policy = _policy(cell.task, cell.rule)
    observation, _ = environment(cell.task, cell.difficulty).reset(seed=cell.seed)
    (plan,) = policy.planner.plan([policy.problem(observation)])
    shown = list(np.array(policy.demonstrations.configurations))
    return {
        "task": cell.task,
        "rule": cell.rule,
        "seed": float(cell.seed),
        "likelihood": _likelihood(cell.task, cell.rule),
        "solved": 100.0 * float(plan.good.any()),
        "good": 100.0 * float(plan.good.mean()),
        "demonstrations": of_trajectories(plan.trajectories, shown)["demonstrations"],
        "seconds": plan.planning_time,
    }
