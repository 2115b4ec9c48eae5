"""Paired differences: means over common scenes, intervals, tests against scipy's."""

import numpy as np
import pytest
from scipy import stats

from smp_planner.experiments.paired_differences import differences, differences_table


def _rows(task, method, values):
    return [
        {"task": task, "method": method, "seed": float(k), "good": value}
        for k, value in enumerate(values)
    ]


def test_differences_are_those_of_common_scenes():
    rng = np.random.default_rng(0)
    first, second = rng.normal(10.0, 3.0, 25), rng.normal(9.0, 3.0, 25)
    rows = [
        *_rows("DrawS", "smp", first),
        *_rows("DrawS", "other", [*second, 5.0]),
        *_rows("Placement", "smp", [None, 1.0, 2.0, 4.0]),
        *_rows("Placement", "other", [7.0, 3.0, None, 3.0]),
    ]
    drawing, placing = differences(rows, "smp", ["good"])
    assert (drawing.scenes, placing.scenes) == (25, 2)
    assert drawing.mean == pytest.approx((second - first).mean())
    assert drawing.p_value == pytest.approx(stats.wilcoxon(second - first).pvalue)
    assert drawing.low < drawing.mean < drawing.high
    assert placing.mean == pytest.approx(0.5)
    assert drawing.corrected == pytest.approx(min(1.0, 2.0 * drawing.p_value))


def test_the_interval_covers_the_true_difference():
    """95 % intervals of 200 samples of a known distribution hold its mean about as often."""
    rng, held = np.random.default_rng(1), 0
    for _ in range(60):
        pairs = rng.normal([0.0, 0.7], 1.0, (30, 2))
        rows = [*_rows("DrawS", "smp", pairs[:, 0]), *_rows("DrawS", "other", pairs[:, 1])]
        (found,) = differences(rows, "smp", ["good"])
        held += found.low <= 0.7 <= found.high
    assert 50 <= held <= 60


def test_equal_measures_do_not_differ():
    rows = [*_rows("DrawS", "smp", [1.0, 2.0]), *_rows("DrawS", "other", [1.0, 2.0])]
    (found,) = differences(rows, "smp", ["good"])
    assert (found.mean, found.p_value) == (0.0, 1.0)
    head, row = differences_table([found])
    assert len(head) == len(row)
    assert row[:4] == ["DrawS", "other", "good", "2"]
