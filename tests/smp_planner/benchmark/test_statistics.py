"""Intervals and tests against published values, and coverage computed exactly."""

import itertools
import math

import numpy as np
import pytest
from scipy import stats

from smp_planner.benchmark.statistics import (
    PairedCounts,
    holm,
    mcnemar,
    mean_interval,
    paired_difference,
    rate_interval,
    ratio_interval,
    ratio_of_means,
)

BENTUR = PairedCounts(1, 1, 7, 12)
CAVO = PairedCounts(59, 6, 16, 80)


@pytest.mark.parametrize(("successes", "count"), [(0, 7), (7, 7), (187, 200)])
def test_rates_have_wilson_intervals(successes: int, count: int) -> None:
    z = stats.norm.ppf(0.975)
    p = successes / count
    middle = (p + z**2 / (2 * count)) / (1 + z**2 / count)
    half = z / (1 + z**2 / count) * np.sqrt(p * (1 - p) / count + z**2 / (4 * count**2))
    estimate = rate_interval(successes, count)
    assert estimate["value"] == p
    assert estimate["low"] == pytest.approx(middle - half, abs=1e-12)
    assert estimate["high"] == pytest.approx(middle + half, abs=1e-12)


def test_bootstrap_intervals_cover_the_mean_as_often_as_they_say() -> None:
    draw = np.random.default_rng(0)
    covered = 0
    for _ in range(100):
        estimate = mean_interval(draw.exponential(2.0, 60).tolist())
        covered += estimate["low"] <= 2.0 <= estimate["high"]
    assert 85 <= covered <= 100


def test_ratios_have_geometric_means() -> None:
    draw = np.random.default_rng(1)
    below = draw.exponential(1.0, 40)
    above = below * draw.lognormal(math.log(0.25), 0.3, 40)
    estimate = ratio_interval(above.tolist(), below.tolist())
    assert estimate["count"] == 40
    assert estimate["value"] == pytest.approx(stats.gmean(above / below))
    assert estimate["low"] < 0.25 < estimate["high"]
    inverse = ratio_interval(below.tolist(), above.tolist())
    assert inverse["value"] == pytest.approx(1 / estimate["value"])


@pytest.mark.parametrize(
    ("first", "second", "message"),
    [
        ([1.0, 0.0], [1.0, 1.0], r"first must be positive and finite, got \[1.0, 0.0\]"),
        ([1.0], [math.inf], r"second must be positive and finite, got \[inf\]"),
        ([1.0, 2.0], [1.0], "2 of first, 1 of second"),
        ([], [], "0 of first, 0 of second"),
    ],
)
@pytest.mark.parametrize("ratio", [ratio_interval, ratio_of_means])
def test_ratios_need_positive_pairs(ratio, first, second, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ratio(first, second)


def test_a_ratio_of_means_has_the_interval_of_a_paired_bootstrap() -> None:
    draw = np.random.default_rng(2)
    below = draw.lognormal(0.0, 0.4, 30)
    above = 1.3 * below * draw.lognormal(0.0, 0.2, 30)
    estimate = ratio_of_means(above.tolist(), below.tolist())
    assert estimate["count"] == 30
    assert estimate["value"] == pytest.approx(above.sum() / below.sum())
    other = stats.bootstrap(
        (above, below),
        lambda a, b, axis=-1: a.mean(axis) / b.mean(axis),
        paired=True,
        method="percentile",
        rng=np.random.default_rng(3),
    ).confidence_interval
    assert (estimate["low"], estimate["high"]) == pytest.approx((other.low, other.high), rel=0.01)


@pytest.mark.parametrize("values", [[3.0], [3.0, 3.0, 3.0]])
def test_equal_values_have_an_interval_of_width_zero(values: list[float]) -> None:
    estimate = mean_interval(values)
    assert (estimate["value"], estimate["low"], estimate["high"]) == (3.0, 3.0, 3.0)


@pytest.mark.parametrize(
    ("counts", "value", "low", "high"),
    [(BENTUR, -0.286, -0.507, -0.026), (CAVO, -0.0621, -0.1186, -0.0046)],
    ids=["Bentur 2009", "Cavo 2012"],
)
def test_paired_differences_are_those_published(
    counts: PairedCounts, value: float, low: float, high: float
) -> None:
    """By Fagerlund, Lydersen & Laake, "Statistical analysis of contingency tables", chapter 8."""
    estimate = paired_difference(counts)
    found = (estimate["value"], estimate["low"], estimate["high"])
    digits = 3 if counts is BENTUR else 4
    assert tuple(round(number, digits) for number in found) == (value, low, high)
    # The other one first: the interval is its mirror image.
    swapped = PairedCounts(counts.both, counts.second_only, counts.first_only, counts.neither)
    mirrored = paired_difference(swapped)
    assert (mirrored["low"], mirrored["high"]) == pytest.approx((-found[2], -found[1]))


def test_the_exact_test_has_the_published_p_value() -> None:
    """Of Bentur 2009: one in favour, seven against."""
    assert mcnemar(BENTUR) == pytest.approx(0.0703, abs=5e-5)
    assert mcnemar(BENTUR) == pytest.approx(2 * (1 + 8) / 2**8)
    assert mcnemar(PairedCounts(5, 0, 0, 5)) == 1.0
    assert mcnemar(PairedCounts(5, 2, 2, 5)) == 1.0


def _probabilities(n: int, cells: tuple[float, ...]) -> dict[PairedCounts, float]:
    """Return the probability of all counts of n episodes, by the multinomial distribution."""
    found = {}
    for both, first, second in itertools.product(range(n + 1), repeat=3):
        if both + first + second <= n:
            counts = (both, first, second, n - both - first - second)
            found[PairedCounts(*counts)] = float(stats.multinomial.pmf(counts, n, cells))
    return found


def test_paired_intervals_cover_the_difference_as_often_as_they_say() -> None:
    cells = (0.6, 0.2, 0.1, 0.1)
    covered = sum(
        probability
        for counts, probability in _probabilities(12, cells).items()
        if (interval := paired_difference(counts))["low"] <= 0.1 <= interval["high"]
    )
    assert 0.94 <= covered <= 0.99


def test_the_exact_test_is_wrong_as_seldom_as_it_says() -> None:
    rejected = sum(
        probability
        for counts, probability in _probabilities(12, (0.3, 0.3, 0.3, 0.1)).items()
        if mcnemar(counts) < 0.05
    )
    assert 0.0 < rejected <= 0.05


def test_all_or_nothing_has_an_interval_within_bounds() -> None:
    for counts in (PairedCounts(0, 10, 0, 0), PairedCounts(10, 0, 0, 0), PairedCounts(0, 0, 0, 1)):
        estimate = paired_difference(counts)
        assert -1.0 <= estimate["low"] <= estimate["value"] <= estimate["high"] <= 1.0
        assert math.isfinite(estimate["low"])


def test_counts_are_of_pairs() -> None:
    counts = PairedCounts.of([True, True, False, False, True], [True, False, True, False, True])
    assert counts == PairedCounts(2, 1, 1, 1)
    assert (counts.count, counts.of_first, counts.of_second) == (5, 3, 3)
    with pytest.raises(ValueError, match="in pairs, got 1 of the first, 2 of the second"):
        PairedCounts.of([True], [True, False])
    with pytest.raises(ValueError, match="nor all zero"):
        PairedCounts.of([], [])


def test_holm_corrects_step_by_step() -> None:
    # 4 · 0.005, 3 · 0.01, 2 · 0.03, and 0.04, which is not below the one before.
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.5, 0.9]) == [1.0, 1.0]
    assert holm([]) == []
    with pytest.raises(ValueError, match=r"within \[0, 1\], got \[1.5\]"):
        holm([1.5])
