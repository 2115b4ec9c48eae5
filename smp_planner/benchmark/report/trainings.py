"""Several trainings of one agent, which are methods of their own in the rows, taken together.

Trainings that differ in their seed alone are named ``NAME-seed0``, ``NAME-seed1`` and so on. Chance
in training is a source of error beside chance in scenes: the interval here is of a bootstrap that
draws trainings anew, cell by cell.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from smp_planner.benchmark.aggregates import interquartile_mean
from smp_planner.benchmark.joined_results import Episode, JoinedResults
from smp_planner.benchmark.statistics import Estimate

__all__ = ["Trainings", "trainings"]

_NAME = re.compile(r"(?P<agent>.+)-seed\d+(?P<folder>@.*)?")


@dataclass(frozen=True)
class Trainings:
    """Success of an agent over its trainings.

    Attributes:
        agent: name without the seeds.
        methods: names of the trainings.
        rates: success of each, over all episodes.
        typical: interquartile mean of the success of all trainings and cells.
    """

    agent: str
    methods: tuple[str, ...]
    rates: tuple[float, ...]
    typical: Estimate

    @property
    def range(self) -> tuple[float, float]:
        """Success of the worst and of the best training."""
        return min(self.rates), max(self.rates)


def trainings(
    results: JoinedResults, methods: Sequence[str], episodes: Sequence[Episode]
) -> list[Trainings]:
    """Return the agents of which there are two trainings or more.

    Args:
        results: of all methods.
        methods: names of those that are looked at.
        episodes: that all of them have played, at least one.
    """
    groups: dict[str, list[str]] = {}
    for method in methods:
        if match := _NAME.fullmatch(method):
            groups.setdefault(match["agent"] + (match["folder"] or ""), []).append(method)
    return [_together(results, agent, of, episodes) for agent, of in groups.items() if len(of) > 1]


def _together(
    results: JoinedResults, agent: str, methods: Sequence[str], episodes: Sequence[Episode]
) -> Trainings:
    cells = dict.fromkeys(episode.cell for episode in episodes)
    scores = {
        cell.name: [_rate(results, m, [e for e in episodes if e.cell == cell]) for m in methods]
        for cell in cells
    }
    return Trainings(
        agent,
        tuple(methods),
        tuple(_rate(results, method, episodes) for method in methods),
        interquartile_mean(scores),
    )


def _rate(results: JoinedResults, method: str, episodes: Sequence[Episode]) -> float:
    return sum(results.rows[method][episode].success for episode in episodes) / len(episodes)
