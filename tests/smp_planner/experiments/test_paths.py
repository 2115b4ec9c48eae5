"""What is measured of sets of paths in the plane, against sampling and hand calculation."""

import numpy as np
import pytest
from numpy.typing import NDArray

from smp_planner.benchmark import metrics
from smp_planner.experiments.paths import (
    classes,
    clearances,
    diversity,
    similarity,
)
from smp_planner.experiments.posterior import within_spread
from smp_planner.library.smp import Circle

FloatArray = NDArray[np.float64]
CIRCLE = Circle((0.0, 0.0), 1.0)
ENDS = np.array([[-3.0, -0.5], [3.0, -0.5]])


def _arch(height: float, start: float = -3.0) -> FloatArray:
    x = np.linspace(start, 3.0, 41)
    return np.stack([x, height * np.cos(x * np.pi / 6.0)], axis=-1)


def test_clearance_agrees_with_dense_sampling() -> None:
    rng = np.random.default_rng(0)
    paths = np.cumsum(rng.normal(size=(20, 6, 2)), axis=1)
    circles = (CIRCLE, Circle((2.0, 1.0), 0.5))
    fine = metrics.resample(paths, 50_001)
    wanted = np.min(
        [np.linalg.norm(fine - c.center, axis=-1).min(axis=1) - c.radius for c in circles], axis=0
    )
    assert np.allclose(clearances(paths, circles), wanted, atol=1e-3)
    assert (clearances(paths, circles) <= wanted + 1e-12).all()


def test_clearance_sees_what_lies_between_samples() -> None:
    through = np.array([[[-5.0, 0.5], [5.0, 0.5]]])
    assert clearances(through, (CIRCLE,)) == pytest.approx([-0.5])
    assert np.isinf(clearances(through, ())).all()


def test_classes_do_not_depend_on_what_else_is_in_the_set() -> None:
    above, below = _arch(2.0), _arch(-2.0)
    both = classes(np.stack([above, below]), (CIRCLE,), ENDS)
    assert both[0, 0] != both[1, 0]
    for index, path in enumerate((above, below)):
        alone = classes(path[None], (CIRCLE,), ENDS)
        beside = classes(np.stack([path, _arch(2.0, -2.5)]), (CIRCLE,), ENDS)
        assert alone[0, 0] == beside[0, 0] == both[index, 0]


def test_similarity() -> None:
    reference = np.stack([_arch(h) for h in np.linspace(1.0, 2.0, 20)])
    assert similarity(reference, reference)["wasserstein"] == pytest.approx(0.0, abs=1e-9)
    moved = similarity(reference + np.array([3.0, 4.0]), reference)
    assert moved["wasserstein"] == pytest.approx(5.0)
    assert set(similarity(reference[:0], reference).values()) == {None}


def test_diversity_is_the_mean_over_pairs() -> None:
    path = _arch(1.0)
    paths = np.stack([path, path + np.array([3.0, 4.0]), path])
    assert diversity(paths) == pytest.approx((5.0 + 5.0 + 0.0) / 3.0)
    assert diversity(paths[:1]) == 0.0


def test_spread_within_ways_takes_no_notice_of_their_distance() -> None:
    rng = np.random.default_rng(1)
    label = np.repeat([0, 1, 2], [400, 500, 1])
    offsets = np.array([[0.0, 0.0], [50.0, 0.0], [0.0, 90.0]])[label]
    paths = (offsets + rng.normal(0.0, 2.0, (901, 2)))[:, None].repeat(5, axis=1)
    # Two coordinates of standard deviation 2 each.
    assert within_spread(paths, label[:, None]) == pytest.approx(np.sqrt(8.0), rel=0.05)
    assert within_spread(paths[[0, 400, 900]], label[[0, 400, 900], None]) is None
