"""Weights of a population: effective size, rise of the temperature, systematic resampling."""

import numpy as np
import pytest

from smp_planner.inference.resampling import effective_size, resampled, temperature_rise


def test_the_effective_size_is_that_of_equal_weights():
    assert effective_size(np.zeros(7)) == pytest.approx(7.0)
    assert effective_size(np.array([0.0, 0.0, -800.0, -900.0]) + 5.0) == pytest.approx(2.0)
    weights = np.array([0.5, 0.3, 0.2])
    assert effective_size(np.log(weights)) == pytest.approx(1.0 / np.square(weights).sum())


def test_the_temperature_rises_until_the_size_wanted_is_left():
    values = -np.random.default_rng(0).gamma(2.0, 5.0, size=200)
    rise = temperature_rise(values, 1.0, 50.0)
    assert effective_size(rise * values) == pytest.approx(50.0, rel=1e-3)
    assert temperature_rise(1e-6 * values, 0.4, 50.0) == 0.4


def test_each_is_chosen_as_often_as_its_weight_says():
    weights = np.array([0.1, 0.0, 0.55, 0.35])
    with np.errstate(divide="ignore"):
        chosen = resampled(np.log(weights) + 3.0, 100, np.random.default_rng(1))
    counts = np.bincount(chosen, minlength=4)
    assert np.abs(counts - 100 * weights).max() < 1.0 + 1e-9
    assert (np.diff(chosen) >= 0).all()
    few = [resampled(np.log([0.3, 0.7]), 1, np.random.default_rng(s))[0] for s in range(400)]
    assert np.mean(few) == pytest.approx(0.7, abs=0.08)
