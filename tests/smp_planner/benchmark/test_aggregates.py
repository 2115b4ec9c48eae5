"""Aggregates against SciPy, and bootstraps whose distribution is known."""

import numpy as np
import pytest
from scipy import stats

from smp_planner.benchmark.aggregates import (
    Scores,
    improvement_probability,
    interquartile_mean,
    performance_profile,
)

DRAW = np.random.default_rng(3)
FIRST = {"a": DRAW.normal(0.3, 1.0, 30).round(1), "b": DRAW.normal(0.0, 1.0, 17).round(1)}
SECOND = {"a": DRAW.normal(0.0, 1.0, 30).round(1), "b": DRAW.normal(0.0, 1.0, 17).round(1)}


def test_interquartile_mean_is_scipy_s_trimmed_mean() -> None:
    together = np.concatenate(list(FIRST.values()))
    estimate = interquartile_mean(FIRST)
    assert estimate["value"] == pytest.approx(stats.trim_mean(together, 0.25))
    assert estimate["count"] == 47
    alone = interquartile_mean({"a": FIRST["a"]})
    reference = stats.bootstrap(
        (FIRST["a"],), lambda x, axis: stats.trim_mean(x, 0.25, axis=axis), method="percentile"
    ).confidence_interval
    assert (alone["low"], alone["high"]) == pytest.approx(tuple(reference), abs=0.05)


def test_failures_beyond_a_quarter_make_an_interquartile_mean_infinite() -> None:
    few, many = np.ones(40), np.ones(40)
    few[:2], many[:20] = -np.inf, -np.inf
    assert interquartile_mean({"a": few}) == {"count": 40, "value": 1.0, "low": 1.0, "high": 1.0}
    estimate = interquartile_mean({"a": many})
    assert (estimate["value"], estimate["low"]) == (-np.inf, -np.inf)


def test_improvement_is_the_statistic_of_mann_and_whitney() -> None:
    by_task = [
        stats.mannwhitneyu(FIRST[task], SECOND[task]).statistic
        / (len(FIRST[task]) * len(SECOND[task]))
        for task in FIRST
    ]
    estimate = improvement_probability(FIRST, SECOND)
    assert estimate["value"] == pytest.approx(np.mean(by_task))
    assert estimate["low"] < estimate["value"] < estimate["high"]
    backwards = improvement_probability(SECOND, FIRST)
    assert backwards["value"] == pytest.approx(1.0 - estimate["value"])


def test_improvement_of_normal_scores_is_known() -> None:
    first, second = np.random.default_rng(0).normal((1.0, 0.0), 1.0, (300, 2)).T
    estimate = improvement_probability({"a": first}, {"a": second})
    truth = stats.norm.cdf(1.0 / np.sqrt(2.0))
    assert estimate["low"] < truth < estimate["high"]
    # The variance of the statistic, of Φ(1/√2) and of equal numbers (Hanley & McNeil 1982).
    q = float(stats.multivariate_normal([0, 0], [[1, 0.5], [0.5, 1]]).cdf([1 / np.sqrt(2)] * 2))
    spread = np.sqrt((truth * (1 - truth) + 2 * 299 * (q - truth**2)) / 300**2)
    assert estimate["high"] - estimate["low"] == pytest.approx(2 * 1.96 * spread, rel=0.1)


def test_pairs_are_drawn_together() -> None:
    count = 200
    better = np.arange(count) < 150
    first = np.arange(count) + 0.5 * better
    estimate = improvement_probability({"a": first}, {"a": np.arange(count) + 0.25}, paired=True)
    assert estimate["value"] == 0.75
    known = stats.binom(count, 0.75).ppf([0.025, 0.975]) / count
    assert (estimate["low"], estimate["high"]) == pytest.approx(known, abs=0.006)


def test_failures_of_both_count_half() -> None:
    first, second = {"a": [-np.inf, -np.inf]}, {"a": [-np.inf, -1.0]}
    assert improvement_probability(first, second, paired=True)["value"] == 0.25


def test_profiles_are_shares_of_runs_with_the_binomial_s_spread() -> None:
    scores: Scores = {"a": np.append(np.arange(199.0), -np.inf)}
    profile = performance_profile(scores, [-np.inf, 0.0, 49.0, 198.0, 199.0])
    np.testing.assert_allclose(profile["value"], [1.0, 0.995, 0.75, 0.005, 0.0])
    known = stats.binom(200, 0.75).ppf([0.025, 0.975]) / 200
    assert (profile["low"][2], profile["high"][2]) == pytest.approx(known, abs=0.006)
    assert (profile["low"][0], profile["high"][4]) == (1.0, 0.0)


def test_tasks_count_equally_in_a_profile() -> None:
    profile = performance_profile({"a": [1.0], "b": [0.0, 0.0, 0.0]}, [0.5])
    assert profile["value"] == [0.5]
    # Runs are drawn anew, tasks are not.
    assert (profile["low"], profile["high"]) == ([0.5], [0.5])


@pytest.mark.parametrize(
    ("scores", "message"),
    [
        ({}, "a task at least, got none"),
        ({"a": []}, r"\['a'\] must have shape"),
        ({"a": [[1.0]]}, r"\['a'\] must have shape"),
        ({"a": [np.nan]}, r"\['a'\] must be numbers"),
    ],
)
def test_scores_that_are_none_are_refused(scores: Scores, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        performance_profile(scores, [0.0])
    with pytest.raises(ValueError, match=message):
        interquartile_mean(scores)


def test_tasks_and_pairs_must_agree() -> None:
    with pytest.raises(ValueError, match=r"tasks must be the same, got \['a'\] and \['b'\]"):
        improvement_probability({"a": [1.0]}, {"b": [1.0]})
    with pytest.raises(ValueError, match="in pairs, got 1, 2 of 'a'"):
        improvement_probability({"a": [1.0]}, {"a": [1.0, 2.0]}, paired=True)
