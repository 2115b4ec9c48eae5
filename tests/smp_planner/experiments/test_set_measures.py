"""Measures of sets of trajectories: shifted sets, covered draws, distances to demonstrations."""

import numpy as np
import pytest

from smp_planner.experiments.set_measures import (
    PosteriorSample,
    against_posterior,
    of_trajectories,
    total_variation,
)


def _draws(count, seed, scale=0.3):
    """Return smooth trajectories (count, 60, 3) about a common one."""
    phase = np.linspace(0.0, 1.0, 60)[:, None]
    rng = np.random.default_rng(seed)
    bends = scale * rng.standard_normal((count, 1, 3))
    return np.sin(2.0 * phase) + bends * np.sin(np.pi * phase)


def test_a_shifted_set_is_as_far_as_it_is_shifted():
    draws = _draws(40, 0)
    sample = PosteriorSample(draws, draws, 0.01)
    shift = np.array([0.3, 0.0, -0.4])
    assert against_posterior(draws, sample)["wasserstein"] == pytest.approx(0.0, abs=1e-9)
    assert against_posterior(draws + 10.0 * shift, sample)["wasserstein"] == pytest.approx(5000.0)


def test_the_draws_that_are_near_a_set_are_covered():
    draws = _draws(40, 1)
    sample = PosteriorSample(draws, draws, 1e-6)
    assert against_posterior(draws[:10], sample)["coverage"] == 25.0
    assert against_posterior(draws + 1.0, sample)["coverage"] == 0.0


def test_fresh_draws_cover_half_of_the_posterior():
    covered = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        sample = PosteriorSample.of(_draws(200, seed), _draws(200, 100 + seed), 42, rng)
        assert sample.floor.shape == (42, 60, 3)
        covered.append(against_posterior(sample.floor, sample)["coverage"])
    assert abs(np.mean(covered) - 50.0) < 3.0 * np.std(covered) / np.sqrt(len(covered))


def test_without_enough_draws_there_is_no_sample():
    rng = np.random.default_rng(0)
    assert PosteriorSample.of(_draws(1, 0), _draws(20, 1), 42, rng) is None
    assert PosteriorSample.of(_draws(20, 0), _draws(3, 1), 42, rng) is None
    assert len(PosteriorSample.of(_draws(20, 0), _draws(20, 1), 42, rng).floor) == 10


def test_a_set_is_at_no_distance_from_demonstrations_that_are_it():
    demonstrations = list(_draws(7, 3))
    found = of_trajectories(np.stack(demonstrations), demonstrations)
    assert found["demonstrations"] == pytest.approx(0.0, abs=1e-9)
    straight = np.linspace(0.0, 1.0, 60)[:, None] * np.array([3.0, 0.0, 4.0])
    curved = straight + 0.1 * np.sin(np.linspace(0.0, 40.0, 60))[:, None]
    assert of_trajectories(np.stack([straight, straight]), demonstrations)[
        "length"
    ] == pytest.approx(5.0)
    smoother, rougher = (
        of_trajectories(np.stack([paths, paths]), demonstrations)["jerk"]
        for paths in (_draws(1, 4)[0], curved)
    )
    assert smoother > rougher


def test_shares_of_classes_differ_by_what_changes_its_class():
    one = np.array([[0, 1], [0, 1], [0, 2], [1, 1]])
    assert total_variation(one, one[::-1]) == 0.0
    assert total_variation(one, np.array([[5, 5]])) == 1.0
    # A quarter of the set is of another class than in the other, whose size does not matter.
    other = np.repeat(np.array([[0, 1], [0, 1], [0, 2], [0, 2]]), 3, axis=0)
    assert total_variation(one, other) == pytest.approx(0.25)
    assert total_variation(one[:, :1], other[:, :1]) == pytest.approx(0.25)
    apart = np.array([[0], [0], [0], [1]])
    assert total_variation(apart, apart[::-1]) == 0.0
    assert total_variation(apart, np.array([[1], [2]])) == pytest.approx(0.75)
    assert total_variation(apart, np.array([[0], [1]])) == pytest.approx(0.25)
