"""Rates, means and paired differences with their intervals, and tests of several of them at once.

All intervals are of level `CONFIDENCE`. What is aggregated over tasks is in `aggregates`.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import stats

from smp_gym.arrays import FloatArray

__all__ = [
    "CONFIDENCE",
    "Estimate",
    "PairedCounts",
    "holm",
    "mcnemar",
    "mean_interval",
    "paired_difference",
    "rate_interval",
    "ratio_interval",
    "ratio_of_means",
]

CONFIDENCE = 0.95
"""Level of all intervals."""

_RESAMPLES, _RATIO_RESAMPLES = 2000, 9999
_BOOTSTRAP_SEED = 0

Estimate = dict[str, float | int]
"""``count`` of what was measured, ``value``, and the interval from ``low`` to ``high``."""


def rate_interval(successes: int, count: int) -> Estimate:
    """Return a rate with its Wilson interval (Wilson 1927).

    Args:
        successes: how many of `count`.
        count: at least 1.
    """
    low, high = _wilson(successes, count)
    return {"count": count, "value": successes / count, "low": low, "high": high}


@lru_cache(maxsize=2**14)
def _wilson(successes: int, count: int) -> tuple[float, float]:
    """Return the ends of the interval; scipy takes milliseconds, and a report asks very often."""
    test = stats.binomtest(successes, count)
    interval = test.proportion_ci(confidence_level=CONFIDENCE, method="wilson")
    return float(interval.low), float(interval.high)


def mean_interval(values: Sequence[float]) -> Estimate:
    """Return a mean with its bias-corrected and accelerated bootstrap interval (Efron 1987).

    Values that are all equal, or a single one, have the interval of width zero.

    Args:
        values: at least one, finite.
    """
    data = np.asarray(values, np.float64)
    mean = float(data.mean())
    low = high = mean
    if len(data) > 1 and np.ptp(data) > 0.0:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", stats.DegenerateDataWarning)
            interval = stats.bootstrap(
                (data,),
                np.mean,
                confidence_level=CONFIDENCE,
                n_resamples=_RESAMPLES,
                rng=np.random.default_rng(_BOOTSTRAP_SEED),
            ).confidence_interval
        if math.isfinite(interval.low) and math.isfinite(interval.high):
            low, high = float(interval.low), float(interval.high)
    return {"count": len(data), "value": mean, "low": low, "high": high}


def _positive_pairs(first: Sequence[float], second: Sequence[float]) -> FloatArray:
    """Return numerators and denominators (2, n) of ratios, checked."""
    for name, values in (("first", first), ("second", second)):
        numbers = np.asarray(values, np.float64)
        if not (np.isfinite(numbers) & (numbers > 0.0)).all():
            raise ValueError(f"{name} must be positive and finite, got {numbers.tolist()}")
    if not len(first) == len(second) > 0:
        raise ValueError(f"ratios need pairs, got {len(first)} of first, {len(second)} of second")
    return np.array([first, second], np.float64)


def ratio_interval(first: Sequence[float], second: Sequence[float]) -> Estimate:
    """Return the geometric mean of paired ratios with the interval of `mean_interval`.

    Args:
        first: numerators, at least one, positive.
        second: denominators, as many, positive.

    Raises:
        ValueError: a number is not positive and finite, or there are not as many of both.
    """
    above, below = _positive_pairs(first, second)
    logarithm = mean_interval(list(np.log(above / below)))
    ends = {name: math.exp(logarithm[name]) for name in ("value", "low", "high")}
    return {"count": logarithm["count"], **ends}


def ratio_of_means(first: Sequence[float], second: Sequence[float]) -> Estimate:
    """Return the ratio of two means with a percentile bootstrap interval, pairs drawn together.

    Args:
        first: of the numerator, at least one, positive.
        second: of the denominator, as many, positive.

    Raises:
        ValueError: as by `ratio_interval`.
    """
    pairs = _positive_pairs(first, second)
    count = pairs.shape[1]
    drawn = np.random.default_rng(_BOOTSTRAP_SEED).integers(0, count, (_RATIO_RESAMPLES, count))
    above, below = pairs[:, drawn].mean(axis=-1)
    tail = 50.0 * (1.0 - CONFIDENCE)
    low, high = np.percentile(above / below, [tail, 100.0 - tail])
    value = float(pairs[0].mean() / pairs[1].mean())
    return {"count": count, "value": value, "low": float(low), "high": float(high)}


@dataclass(frozen=True)
class PairedCounts:
    """Outcomes of two methods on equal episodes, counted.

    Attributes:
        both: episodes in which both succeed.
        first_only: in which the first alone succeeds.
        second_only: in which the second alone does.
        neither: in which none does.
    """

    both: int
    first_only: int
    second_only: int
    neither: int

    def __post_init__(self) -> None:
        counts = (self.both, self.first_only, self.second_only, self.neither)
        if min(counts) < 0 or not sum(counts):
            raise ValueError(f"counts must not be negative nor all zero, got {counts}")

    @classmethod
    def of(cls, first: Sequence[bool], second: Sequence[bool]) -> PairedCounts:
        """Return the counts of two lists of outcomes, episode by episode.

        Raises:
            ValueError: the lists are empty or of different lengths.
        """
        if len(first) != len(second):
            raise ValueError(
                f"outcomes must come in pairs, got {len(first)} of the first, {len(second)} of "
                "the second"
            )
        a, b = np.asarray(first, bool), np.asarray(second, bool)
        counts = ((a & b).sum(), (a & ~b).sum(), (~a & b).sum(), (~a & ~b).sum())
        return cls(*(int(count) for count in counts))

    @property
    def count(self) -> int:
        """How many episodes there are."""
        return self.both + self.first_only + self.second_only + self.neither

    @property
    def of_first(self) -> int:
        """Successes of the first."""
        return self.both + self.first_only

    @property
    def of_second(self) -> int:
        """Successes of the second."""
        return self.both + self.second_only


def mcnemar(counts: PairedCounts) -> float:
    """Return the p-value of the exact test that both methods succeed equally often.

    If they do, each discordant episode is as likely to favour one as the other; two-sided.

    Source: McNemar 1947, with binomial probabilities in place of its approximation.
    """
    discordant = counts.first_only + counts.second_only
    if not discordant:
        return 1.0
    return float(stats.binomtest(counts.first_only, discordant).pvalue)


def paired_difference(counts: PairedCounts) -> Estimate:
    """Return the first rate less the second with its interval for paired proportions.

    Source: Newcombe 1998, "Improved confidence intervals for the difference between binomial
    proportions based on paired data", method 10: the Wilson limits of both rates, squared and
    added, with a correlation that is corrected for continuity.
    """
    n = counts.count
    first, second = rate_interval(counts.of_first, n), rate_interval(counts.of_second, n)
    difference = first["value"] - second["value"]
    correlation = _correlation(counts)

    def reach(one: float, other: float) -> float:
        return math.sqrt(max(one**2 - 2.0 * correlation * one * other + other**2, 0.0))

    below = reach(first["value"] - first["low"], second["high"] - second["value"])
    above = reach(first["high"] - first["value"], second["value"] - second["low"])
    return {
        "count": n,
        "value": difference,
        "low": max(difference - below, -1.0),
        "high": min(difference + above, 1.0),
    }


def _correlation(counts: PairedCounts) -> float:
    """Return Newcombe's correlation of the outcomes; 0 where one of the rates is 0 or 1."""
    n = counts.count
    margins = counts.of_first * (n - counts.of_first) * counts.of_second * (n - counts.of_second)
    excess = counts.both * counts.neither - counts.first_only * counts.second_only
    if not margins:
        return 0.0
    return (max(excess - n / 2.0, 0.0) if excess > 0 else excess) / math.sqrt(margins)


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p-values corrected for being several, in their order.

    Those of which the corrected one is below α hold together with probability 1 - α at least.

    Source: Holm 1979, "A simple sequentially rejective multiple test procedure".

    Raises:
        ValueError: a value is not within [0, 1].
    """
    if not all(0.0 <= p <= 1.0 for p in p_values):
        raise ValueError(f"p_values must be within [0, 1], got {list(p_values)}")
    corrected = [0.0] * len(p_values)
    largest = 0.0
    for rank, index in enumerate(np.argsort(p_values, kind="stable")):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[index]))
        corrected[index] = largest
    return corrected
