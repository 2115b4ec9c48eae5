"""Scores of methods over tasks and runs: interquartile mean, profile, probability of improvement.

Scores are given by task, an array (N,) of one number for each run, which is an episode or a
training seed; greater is better, and a score may be infinite. Intervals are percentiles of a
bootstrap that draws the runs of each task anew and keeps the tasks.

Source: Agarwal et al. 2021, "Deep reinforcement learning at the edge of the statistical precipice".
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from smp_gym.arrays import FloatArray
from smp_planner.benchmark.statistics import CONFIDENCE, Estimate

__all__ = [
    "Scores",
    "improvement_probability",
    "interquartile_mean",
    "performance_profile",
]

RESAMPLES = 2000
"""Draws of the bootstrap."""

_SEED = 0
_MIDDLE = 0.25

Scores = Mapping[str, ArrayLike]
"""Scores (N,) by the name of the task."""


def _checked(name: str, scores: Scores) -> dict[str, FloatArray]:
    if not scores:
        raise ValueError(f"{name} must hold the scores of a task at least, got none")
    checked = {task: np.asarray(values, np.float64) for task, values in scores.items()}
    for task, values in checked.items():
        if values.ndim != 1 or not len(values):
            raise ValueError(f"{name}[{task!r}] must have shape (N >= 1,), got {values.shape}")
        if np.isnan(values).any():
            raise ValueError(f"{name}[{task!r}] must be numbers, got {values}")
    return checked


def _interval(draws: FloatArray) -> FloatArray:
    """Return the percentiles of draws (B, ...) that bound the interval, (2, ...)."""
    tail = 50.0 * (1.0 - CONFIDENCE)
    # Between an infinite draw and another one there is nothing to interpolate.
    bounds: FloatArray = np.percentile(draws, [tail, 100.0 - tail], axis=0, method="inverted_cdf")
    return bounds


def _estimate(value: float, count: int, draws: FloatArray) -> Estimate:
    low, high = _interval(draws)
    return {"count": count, "value": value, "low": float(low), "high": float(high)}


@lru_cache(maxsize=128)
def _drawn(number: int, count: int) -> FloatArray:
    """Return how often each of the N runs of a task is drawn by each resample, (B, N).

    It says as much as which runs are drawn, and needs no copies of them. All that is compared on a
    task has the same draws. Sums of such counts are exact in single precision.

    Args:
        number: of the task, from which the draws follow.
        count: N.
    """
    rng = np.random.default_rng([_SEED, number])
    return rng.multinomial(count, np.full(count, 1.0 / count), size=RESAMPLES).astype(np.float32)


def interquartile_mean(scores: Scores) -> Estimate:
    """Return the mean of the middle half of the scores of all runs and tasks together.

    Of n scores, the n / 4 least and greatest are left out, rounded down.

    Args:
        scores: may be infinite; so is the mean if the middle half has one that is.

    Raises:
        ValueError: no task, a task without a run, or scores that are no numbers.
    """
    given = list(_checked("scores", scores).values())
    together = np.concatenate(given)
    order = np.argsort(together)
    cut = int(_MIDDLE * len(together))
    times = np.concatenate([_drawn(k, len(values)) for k, values in enumerate(given)], axis=1)
    draws = [
        np.repeat(together[order], drawn.astype(int))[cut : len(together) - cut].mean()
        for drawn in times[:, order]
    ]
    middle = together[order][cut : len(together) - cut]
    return _estimate(float(middle.mean()), len(together), np.array(draws))


def performance_profile(scores: Scores, thresholds: ArrayLike) -> dict[str, FloatArray]:
    """Return the share of runs whose score is at least each threshold; tasks count equally.

    Args:
        scores: may be infinite.
        thresholds: (K,).

    Returns:
        ``value``, ``low`` and ``high``, each (K,), the interval pointwise.

    Raises:
        ValueError: no task, a task without a run, or scores that are no numbers.
    """
    at = np.asarray(thresholds, np.float64)
    reached = [values[:, None] >= at for values in _checked("scores", scores).values()]
    draws = np.zeros((RESAMPLES, len(at)))
    for number, runs in enumerate(reached):
        counts = _drawn(number, len(runs)) @ runs.astype(np.float32)
        draws += counts.astype(np.float64) / (len(runs) * len(reached))
    low, high = _interval(draws)
    return {
        "value": np.mean([runs.mean(axis=0) for runs in reached], axis=0),
        "low": low,
        "high": high,
    }


def improvement_probability(first: Scores, second: Scores, *, paired: bool = False) -> Estimate:
    """Return the probability that a run of the first scores more than one of the second.

    It is the mean over the tasks; equal scores count half. Without pairs it is the statistic of
    Mann and Whitney, over the number of pairs of runs.

    Args:
        first: scores by task, may be infinite.
        second: of the same tasks.
        paired: whether runs of equal index are of one episode; these are then compared, and drawn
            together.

    Returns:
        An estimate; its count is of the runs of the first.

    Raises:
        ValueError: tasks differ, with `paired` also numbers of runs, or see `performance_profile`.
    """
    a, b = _checked("first", first), _checked("second", second)
    if a.keys() != b.keys():
        raise ValueError(f"tasks must be the same, got {sorted(a)} and {sorted(b)}")
    if paired and (task := next((t for t in a if len(a[t]) != len(b[t])), None)):
        raise ValueError(f"runs must come in pairs, got {len(a[task])}, {len(b[task])} of {task!r}")
    value, draws = 0.0, np.zeros(RESAMPLES)
    for number, task in enumerate(a):
        one, other = a[task], b[task]
        times = _drawn(2 * number, len(one))
        if paired:
            wins = _wins(one, other)
            draws += times @ wins / len(one)
        else:
            wins = _wins(one[:, None], other[None])
            draws += ((times @ wins) * _drawn(2 * number + 1, len(other))).sum(axis=1) / wins.size
        value += float(wins.mean())
    return _estimate(value / len(a), sum(map(len, a.values())), draws / len(a))


def _wins(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return 1 where the first score is greater, and ½ where they are equal."""
    wins: FloatArray = ((first > second) + 0.5 * (first == second)).astype(np.float32)
    return wins
