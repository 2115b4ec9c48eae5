import math
from functools import cache

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment
from scipy.stats import wasserstein_distance

from smp_planner.benchmark.metrics import (
    COMPARED_SAMPLES,
    Metrics,
    SuccessRates,
    compare,
    frechet,
    frechet_distances,
    log_dimensionless_jerk,
    mmd,
    path_lengths,
    resample,
    rms_distances,
    success_rates,
    wasserstein,
)
from smp_planner.planners.rrt_connect.shortcutting import minimum_jerk

BETWEEN_SETS = [mmd, wasserstein, frechet]


def draw(seed, count, samples=12, dimensions=3, offset=0.0):
    """Return random walks (count, samples, dimensions)."""
    steps = np.random.default_rng(seed).normal(size=(count, samples, dimensions))
    return 0.1 * steps.cumsum(axis=1) + offset


def still(points, samples=4):
    """Return trajectories (N, samples, d) that stay at points (N, d)."""
    return np.repeat(np.asarray(points, np.float64)[:, None], samples, axis=1)


def slow_rms(x, y):
    total = sum((p - q) ** 2 for u, v in zip(x, y, strict=True) for p, q in zip(u, v, strict=True))
    return math.sqrt(total / len(x))


def slow_frechet(x, y):
    """The definition of Eiter & Mannila 1994, term by term."""

    @cache
    def coupled(i, j):
        here = math.dist(x[i], y[j])
        before = [
            coupled(u, v) for u, v in ((i - 1, j), (i, j - 1), (i - 1, j - 1)) if u >= 0 and v >= 0
        ]
        return max(here, min(before)) if before else here

    return coupled(len(x) - 1, len(y) - 1)


def test_rms_distances_are_those_of_the_definition():
    a, b = draw(0, 3), draw(1, 4)
    expected = [[slow_rms(x, y) for y in b] for x in a]
    np.testing.assert_allclose(rms_distances(a, b), expected, rtol=1e-12)


@pytest.mark.parametrize("bandwidth", [None, 0.3])
def test_mmd_is_that_of_a_double_loop(bandwidth):
    a, b = draw(2, 5), draw(3, 6, offset=0.2)
    pairs = [slow_rms(b[i], b[j]) for i in range(len(b)) for j in range(i)]
    h = bandwidth or np.median(pairs)

    def mean(first, second):
        kernel = [math.exp(-(slow_rms(x, y) ** 2) / (2 * h * h)) for x in first for y in second]
        return sum(kernel) / len(kernel)

    expected = math.sqrt(mean(a, a) + mean(b, b) - 2 * mean(a, b))
    assert mmd(a, b, bandwidth) == pytest.approx(expected, rel=1e-10)
    assert expected > 0.1


def test_mmd_of_two_points_is_analytic():
    # Two trajectories at distance r: MMD² = 2 - 2 exp(-r² / 2h²).
    near, far = still([[0.0]]), still([[3.0]])
    expected = math.sqrt(2 - 2 * math.exp(-(3.0**2) / (2 * 2.0**2)))
    assert mmd(near, far, bandwidth=2.0) == pytest.approx(expected, rel=1e-12)
    assert mmd(near, still([[1e6]]), bandwidth=2.0) == pytest.approx(math.sqrt(2))


def test_mmd_approaches_that_of_the_gaussians_drawn_from():
    # Of N(0, s²) and N(u, s²): MMD² = 2 h / √(h² + 2 s²) (1 - exp(-u² / (2 h² + 4 s²))).
    draws = np.random.default_rng(4).normal(size=(2, 2000, 1))
    s, u, h = 1.0, 1.0, 1.5
    spread = h * h + 2 * s * s
    expected = math.sqrt(2 * h / math.sqrt(spread) * (1 - math.exp(-u * u / (2 * spread))))
    assert mmd(still(draws[0]), still(draws[1] + u), h) == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("count", [1, 2, 7])
def test_wasserstein_of_equal_sizes_is_the_best_assignment(count):
    a, b = draw(5, count), draw(6, count, offset=0.1)
    cost = np.array([[slow_rms(x, y) for y in b] for x in a])
    expected = cost[linear_sum_assignment(cost)].mean()
    assert wasserstein(a, b) == pytest.approx(expected, rel=1e-10)


def test_wasserstein_of_still_trajectories_on_a_line_is_that_of_numbers():
    generator = np.random.default_rng(7)
    a, b = generator.normal(size=(9, 1)), generator.gumbel(size=(14, 1))
    expected = wasserstein_distance(a[:, 0], b[:, 0])
    assert wasserstein(still(a), still(b)) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("samples", [(2, 2), (9, 9), (7, 12)])
def test_frechet_is_that_of_the_recursive_definition(samples):
    a, b = draw(8, 4, samples[0]), draw(9, 5, samples[1])
    expected = np.array([[slow_frechet(x, y) for y in b] for x in a])
    np.testing.assert_allclose(frechet_distances(a, b), expected, rtol=1e-12)
    both = (expected.min(axis=1).mean() + expected.min(axis=0).mean()) / 2
    assert frechet(a, b) == pytest.approx(both, rel=1e-12)


def test_frechet_of_known_curves():
    s = np.linspace(0.0, 1.0, 41)
    line = np.stack([s, 0 * s], axis=1)
    beside = line + np.array([0.0, 0.3])
    backwards = line[::-1]
    angle = 2 * np.pi * s
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    (found,) = frechet_distances([line], [line, beside, backwards])
    np.testing.assert_allclose(found, [0.0, 0.3, 1.0], atol=1e-12)
    assert frechet_distances([ring], [2.5 * ring]) == pytest.approx(1.5)


def test_frechet_does_not_see_the_pace_and_rms_does():
    s = np.linspace(0.0, 1.0, 1001)
    slow, fast = s[None, :, None], (s**2)[None, :, None]
    assert frechet_distances(slow, fast)[0, 0] < 2e-3
    # ∫ (s - s²)² ds = 1/30
    assert rms_distances(slow, fast)[0, 0] == pytest.approx(math.sqrt(1 / 30), rel=2e-3)


def test_frechet_sees_a_lost_mode_from_one_side():
    modes = still([[-1.0], [1.0]])
    assert frechet(modes[:1], modes) == pytest.approx(0.5)
    assert frechet(modes, modes[:1]) == pytest.approx(0.5)


@pytest.mark.parametrize("metric", BETWEEN_SETS)
def test_equal_sets_are_at_zero_and_others_are_not(metric):
    a, b = draw(10, 8), draw(11, 8)
    assert metric(a, a) == pytest.approx(0.0, abs=1e-12)
    assert metric(a, b) > 0.01


@pytest.mark.parametrize("metric", BETWEEN_SETS)
def test_order_place_and_repetition_do_not_matter(metric):
    a, b = draw(12, 6), draw(13, 9, offset=0.1)
    expected = pytest.approx(metric(a, b), rel=1e-9)
    shuffled = np.random.default_rng(14).permutation(b)
    assert metric(a[::-1], shuffled) == expected
    shift = np.array([5.0, -3.0, 1.0])
    assert metric(a + shift, b + shift) == expected
    assert metric(np.repeat(a, 3, axis=0), b) == expected


@pytest.mark.parametrize("metric", [lambda a, b: mmd(a, b, 0.5), wasserstein, frechet])
def test_both_ways_are_equal(metric):
    a, b = draw(15, 6), draw(16, 9, offset=0.1)
    assert metric(a, b) == pytest.approx(metric(b, a), rel=1e-9)


def test_only_mmd_does_not_grow_with_the_unit():
    a, b = draw(17, 6), draw(18, 9, offset=0.1)
    assert mmd(1000 * a, 1000 * b) == pytest.approx(mmd(a, b), rel=1e-9)
    for metric in (wasserstein, frechet):
        assert metric(1000 * a, 1000 * b) == pytest.approx(1000 * metric(a, b), rel=1e-9)


def test_shift_of_a_set_is_how_far_it_was_moved():
    a = draw(19, 6)
    assert wasserstein(a, a + np.array([0.0, 0.0, 2.0])) == pytest.approx(2.0)


def test_path_length_is_that_of_a_polyline_and_of_a_circle():
    angle = np.linspace(0.0, 2 * np.pi, 2000)
    circle = 0.5 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    assert path_lengths([circle])[0] == pytest.approx(np.pi, rel=1e-5)
    corner = [[0.0, 0.0], [3.0, 4.0], [3.0, 5.0]]
    np.testing.assert_allclose(path_lengths([corner, corner[::-1]]), [6.0, 6.0])


@pytest.mark.parametrize("samples", [51, 200])
def test_smoothness_of_minimum_jerk_is_analytic(samples):
    # x = 10 s³ - 15 s⁴ + 6 s⁵: ∫ x'''² = 720, greatest velocity 15/8.
    path = minimum_jerk(np.linspace(0.0, 1.0, samples))[:, None] * [0.3, -0.4, 1.2]
    expected = -math.log(720 / (15 / 8) ** 2)
    # The greatest velocity lies between two samples where their number is even.
    assert log_dimensionless_jerk([path])[0] == pytest.approx(expected, abs=1e-3)


def test_smoothness_of_a_circle_and_of_a_sine_is_analytic():
    angle = 2 * np.pi * np.linspace(0.0, 1.0, 201)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    sine = np.stack([np.sin(angle), 0 * angle], axis=1)
    expected = [-math.log((2 * np.pi) ** 4), -math.log((2 * np.pi) ** 4 / 2)]
    np.testing.assert_allclose(log_dimensionless_jerk([circle, sine]), expected, rtol=1e-5)


def test_smoothness_falls_with_noise_and_sees_neither_size_nor_place():
    path = minimum_jerk(np.linspace(0.0, 1.0, 100))[:, None] * [1.0, 2.0]
    noisy = path + 1e-3 * np.random.default_rng(20).normal(size=path.shape)
    smooth, moved, rough = log_dimensionless_jerk([path, 7.0 * path + 3.0, noisy])
    assert moved == pytest.approx(smooth, abs=1e-6)
    assert rough < smooth - 1.0


def test_resampling_keeps_ends_and_straight_motion_and_changes_no_time():
    s = np.linspace(0.0, 1.0, 7)
    straight = np.stack([s, 2.0 - 3.0 * s], axis=1)
    s = np.linspace(0.0, 1.0, 50)
    (found,) = resample([straight])
    np.testing.assert_allclose(found, np.stack([s, 2.0 - 3.0 * s], axis=1), atol=1e-12)
    walk = draw(21, 3, samples=9)
    np.testing.assert_allclose(resample(walk, 9), walk, atol=1e-12)
    np.testing.assert_allclose(resample(walk, 17)[:, ::2], walk, atol=1e-12)
    np.testing.assert_allclose(resample(walk, 17)[:, 1], walk[:, :2].mean(axis=1), atol=1e-12)


def test_success_is_counted_by_trajectory_and_by_waypoint():
    free = np.ones((4, 5), np.bool_)
    free[0, 2] = False
    reached = np.array([True, True, False, True])
    assert success_rates(free, reached) == SuccessRates(trajectories=0.5, waypoints=0.95)


def test_compare_holds_every_metric():
    particles, reference = draw(22, 5, samples=30), draw(23, 11, samples=80)
    a, b = resample(particles), resample(reference)
    assert a.shape[1] == b.shape[1] == COMPARED_SAMPLES
    lengths = path_lengths(particles)
    assert compare(particles, reference) == Metrics(
        mmd=mmd(a, b),
        wasserstein=wasserstein(a, b),
        frechet=frechet(a, b),
        mean_length=pytest.approx(lengths.mean()),
        min_length=lengths.min(),
        smoothness=pytest.approx(log_dimensionless_jerk(particles).mean()),
    )


def test_fresh_draws_are_nearer_than_another_distribution():
    s = np.linspace(0.0, 1.0, 30)
    shapes = np.stack([s, s**2, np.sin(np.pi * s)])

    def sample(seed, count):
        weights = np.random.default_rng(seed).normal(1.0, 0.1, size=(count, 2, 3))
        return np.swapaxes(weights @ shapes, 1, 2)

    reference = sample(24, 300)
    floor = compare(sample(25, 42), reference)
    bent = compare(sample(26, 42) + 0.2 * np.sin(np.pi * s)[:, None], reference)
    for name in ("mmd", "wasserstein", "frechet"):
        assert 0.0 < 1.5 * getattr(floor, name) < getattr(bent, name)


def bad(value):
    set_ = draw(27, 3)
    set_[1, 2, 0] = value
    return set_


@pytest.mark.parametrize("function", [*BETWEEN_SETS, frechet_distances, rms_distances, compare])
@pytest.mark.parametrize(
    ("value", "message"),
    [
        (np.zeros((0, 12, 3)), r"must have shape \(N >= 1.*got \(0, 12, 3\)"),
        (np.zeros((3, 1, 3)), r"must have shape .*got \(3, 1, 3\)"),
        (np.zeros((3, 12, 0)), r"must have shape .*got \(3, 12, 0\)"),
        (np.zeros((12, 3)), r"must have shape .*got \(12, 3\)"),
        (bad(np.nan), "must be finite, got nan in trajectory 1"),
        (bad(-np.inf), "must be finite, got -inf in trajectory 1"),
    ],
)
def test_bad_sets_are_refused_by_name(function, value, message):
    first, second = ("particles", "reference") if function is compare else ("a", "b")
    with pytest.raises(ValueError, match=f"^{first} {message}"):
        function(value, draw(28, 3))
    with pytest.raises(ValueError, match=f"^{second} {message}"):
        function(draw(28, 3), value)


@pytest.mark.parametrize("function", [mmd, wasserstein, rms_distances])
def test_sets_of_other_samples_are_refused(function):
    with pytest.raises(
        ValueError, match=r"^b must have the T and d of a \(3, 12, 3\), got shape \(3, 13"
    ):
        function(draw(29, 3, samples=12), draw(30, 3, samples=13))


@pytest.mark.parametrize("function", [*BETWEEN_SETS, compare])
def test_sets_of_other_dimensions_are_refused(function):
    with pytest.raises(ValueError, match=r"^(b|reference) must have the .*\(3, 12, 2\)"):
        function(draw(31, 3), draw(32, 3, dimensions=2))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: mmd(draw(33, 3), draw(34, 1)), "^b must hold at least 2"),
        (lambda: mmd(draw(33, 3), still(np.ones((4, 3)), 12)), "^b must hold different"),
        (lambda: compare(draw(33, 3), draw(34, 1)), "^reference must hold at least 2"),
        (lambda: mmd(draw(33, 3), draw(34, 3), 0.0), "^bandwidth must be positive.*got 0.0"),
        (lambda: mmd(draw(33, 3), draw(34, 3), np.nan), "^bandwidth must be positive.*got nan"),
        (lambda: compare(draw(33, 3, samples=5), draw(34, 3)), r"^particles .*T >= 6.*\(3, 5, 3\)"),
        (lambda: log_dimensionless_jerk(draw(33, 3, samples=5)), r"^trajectories .*T >= 6"),
        (lambda: log_dimensionless_jerk(still([[1.0]], 9)), "^trajectories must move.*0 standing"),
        (lambda: path_lengths(bad(np.nan)), "^trajectories must be finite"),
        (lambda: resample(np.zeros((2, 1, 3))), "^trajectories must have shape"),
        (lambda: resample(draw(33, 3), 1), "^samples must be at least 2, got 1"),
        (lambda: success_rates(np.ones((0, 5), bool), np.ones(0, bool)), "^collision_free must"),
        (lambda: success_rates(np.ones((3, 0), bool), np.ones(3, bool)), "^collision_free must"),
        (lambda: success_rates(np.ones((3, 5), bool), np.ones(2, bool)), r"^reached .*\(3,\).*2"),
        (lambda: success_rates(np.ones((3, 5)), np.ones(3, bool)), "^collision_free must be bool"),
        (lambda: success_rates(np.ones((3, 5), bool), np.ones(3)), "^reached must be boolean"),
    ],
)
def test_bad_input_is_refused_by_name(call, message):
    with pytest.raises(ValueError, match=message):
        call()
