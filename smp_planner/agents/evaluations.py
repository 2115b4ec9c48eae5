"""Evaluations of an agent in the course of its training: records, table and curve."""

from __future__ import annotations

from smp_gym.optional_packages import require

require("rl", "smp_planner.agents.evaluations")

import csv
from collections.abc import Mapping
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import Any

import gymnasium
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from stable_baselines3.common.base_class import BaseAlgorithm

from smp_gym.atomic_files import replacing
from smp_gym.rollout import rollout
from smp_planner.agents.decisions import ACTION_REPEAT, acting
from smp_planner.benchmark.results_folder import write_table
from smp_planner.benchmark.statistics import rate_interval

__all__ = ["Evaluation", "draw_curve", "evaluate", "read_evaluations", "write_evaluations"]


@dataclass(frozen=True)
class Evaluation:
    """Success on a list of episodes, acting deterministically; a row of ``evaluations.csv``.

    Attributes:
        steps: environment steps trained.
        episodes: how many were played.
        successes: how many of them succeeded.
        rate: of success.
        low: lower end of its Wilson interval.
        high: upper end.
        collisions: how many ended in a collision.
        mean_steps: mean length of the episodes, environment steps.
    """

    steps: int
    episodes: int
    successes: int
    rate: float
    low: float
    high: float
    collisions: int
    mean_steps: float

    @classmethod
    def from_row(cls, row: Mapping[str, str]) -> Evaluation:
        """Parse a row of ``evaluations.csv``."""
        kinds = {"int": int, "float": float}
        return cls(**{field.name: kinds[str(field.type)](row[field.name]) for field in fields(cls)})


def evaluate(model: BaseAlgorithm, env: gymnasium.Env[Any, Any], seeds: range) -> Evaluation:
    """Play the episodes of some seeds.

    Args:
        model: acts deterministically; a decision lasts as long as its `ACTION_REPEAT` says.
        env: in which an action lasts one step; the last `info` of its episodes says `is_success`
            and `collided`.
        seeds: one for each episode, at least one.
    """
    successes = collisions = steps = 0
    policy = acting(model)
    for seed in seeds:
        played = rollout(env, policy, seed=seed)
        steps += played.steps
        successes += played.success
        collisions += played.info["collided"]
    rate = rate_interval(successes, len(seeds))
    return Evaluation(
        steps=model.num_timesteps * getattr(model, ACTION_REPEAT, 1),
        episodes=len(seeds),
        successes=successes,
        rate=rate["value"],
        low=rate["low"],
        high=rate["high"],
        collisions=collisions,
        mean_steps=steps / len(seeds),
    )


def read_evaluations(path: Path) -> list[Evaluation]:
    """Return the rows of a file of evaluations; none if there is no file.

    Raises:
        ValueError: a row is damaged; the message names file and line.
    """
    if not path.exists():
        return []
    with path.open(newline="") as file:
        reader = csv.DictReader(file)
        try:
            return [Evaluation.from_row(row) for row in reader]
        except (KeyError, TypeError, ValueError) as error:
            line = reader.line_num
            raise ValueError(f"{path}, line {line}, is not an evaluation: {error}") from error


def write_evaluations(path: Path, evaluations: list[Evaluation]) -> None:
    """Write evaluations as CSV."""
    write_table(path, [field.name for field in fields(Evaluation)], map(astuple, evaluations))


def draw_curve(path: Path, evaluations: list[Evaluation], title: str) -> None:
    """Draw the rate of success over the steps trained, its interval as a band.

    Args:
        path: of the picture.
        evaluations: in the order of their steps.
        title: above the axes.
    """
    figure = Figure(figsize=(6.4, 4.0), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    steps = [evaluation.steps / 1000 for evaluation in evaluations]
    low, high = ([getattr(e, end) for e in evaluations] for end in ("low", "high"))
    axes.fill_between(steps, low, high, color="#7fa3ee", alpha=0.35, lw=0, label="95 % interval")
    axes.plot(steps, [e.rate for e in evaluations], color="#2b4c9b", label="success")
    collisions = [e.collisions / e.episodes for e in evaluations]
    axes.plot(steps, collisions, color="#d97706", lw=1, ls="--", label="collision")
    axes.set(xlabel="environment steps / 1000", ylabel="share of episodes", title=title)
    axes.set_ylim(-0.02, 1.02)
    axes.set_xlim(left=0)
    axes.grid(color="#dcd8cf", lw=0.6)
    axes.legend(frameon=False)
    with replacing(path) as aside:
        figure.savefig(aside)
