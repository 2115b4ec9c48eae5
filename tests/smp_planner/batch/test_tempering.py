"""Populations on a device: against one problem's functions, closed forms, and plans without it."""

import numpy as np
import pytest
import torch
from plane_prior import plane_prior

from smp_planner.adaptation import Runs
from smp_planner.adaptation.stein import SteinSettings
from smp_planner.batch.descent import carry_out
from smp_planner.batch.planning import run_of
from smp_planner.batch.tempering import effective_sizes, resampled_rows, temperature_rises
from smp_planner.inference.resampling import effective_size, resampled, temperature_rise
from smp_planner.planners import make_planner

STEPS, PARTICLES = 30, 200
MIDDLE = STEPS // 2
PHASE = MIDDLE / (STEPS - 1)
PLACES = torch.tensor([[0.3, -0.2], [-0.4, 0.1]], dtype=torch.float64)
STD = 0.1


class OneDraw:
    """Gives the same uniform number always."""

    def __init__(self, number):
        self.number = number

    def uniform(self):
        return self.number


@pytest.fixture(scope="module")
def log_weights():
    weights = -torch.from_numpy(np.random.default_rng(0).gamma(2.0, 5.0, size=(5, 168)))
    return weights * torch.tensor([[1e-6], [0.01], [1.0], [30.0], [1000.0]])


def test_sizes_are_those_of_each_row(log_weights):
    expected = [effective_size(row.numpy()) for row in log_weights]
    np.testing.assert_allclose(effective_sizes(log_weights), expected)


def test_temperatures_rise_as_far_as_those_of_each_row(log_weights):
    expected = [temperature_rise(row.numpy(), 1.0, 42.0) for row in log_weights]
    np.testing.assert_allclose(temperature_rises(log_weights, 42.0), expected, atol=2e-6)
    assert expected[0] == 1.0
    assert expected[-1] < 1e-3


def test_what_is_chosen_is_what_is_chosen_of_each_row(log_weights):
    draws = torch.tensor([[0.0], [0.2], [0.5], [0.77], [0.99]], dtype=torch.float64)
    rows = resampled_rows(log_weights, 42, draws)
    for row, log_weight, number in zip(rows, log_weights, draws, strict=True):
        np.testing.assert_array_equal(
            row, resampled(log_weight.numpy(), 42, OneDraw(float(number)))
        )


class Observed:
    """The middle of the paths of each of two runs, observed at a place of its own."""

    def __init__(self, tables):
        pass

    def gradient(self, trajectories, progress):
        found = torch.zeros_like(trajectories)
        found[:, :, MIDDLE] = (trajectories[:, :, MIDDLE] - PLACES[:, None]) / STD**2
        return found

    def weighted_sum(self, trajectories):
        off = (trajectories[:, :, MIDDLE] - PLACES[:, None]) / STD
        return 0.5 * off.square().sum(-1)


@pytest.fixture(scope="module")
def prior():
    return plane_prior()


def adapted(prior, seed, draws=4 * PARTICLES):
    runs = Runs.of([prior, prior], STEPS)
    generator = torch.Generator().manual_seed(0)
    latent = torch.randn(2, draws, prior.rank, generator=generator, dtype=torch.float64)
    work = run_of(SteinSettings(inference="tempered", iterations=50), PARTICLES)
    return carry_out(work, runs, latent, None, Observed, seed)


def test_each_of_a_batch_has_the_mean_and_the_spread_of_its_posterior(prior):
    found = adapted(prior, 0)
    assert found.shape == (2, PARTICLES, prior.rank)
    for latent, place in zip(found, PLACES, strict=True):
        exact = prior.condition(PHASE, place, torch.full((2,), STD**2))
        mean, covariance = (value.numpy() for value in exact.marginal(PHASE))
        std = np.sqrt(np.diag(covariance))
        middles = prior.trajectory(prior.unwhiten(latent), STEPS)[:, MIDDLE].numpy()
        assert np.abs(middles.mean(axis=0) - mean).max() < 0.25 * std.max()
        assert np.abs(middles.std(axis=0) / std - 1.0).max() < 0.2
        # What is not observed keeps the spread of the prior.
        whole = exact.whiten(prior.unwhiten(latent))
        assert whole.std().item() == pytest.approx(1.0, abs=0.1)


def test_the_same_seed_gives_the_same_particles_and_another_one_others(prior):
    first, second, other = (adapted(prior, seed, PARTICLES) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, second)
    assert (first - other).abs().mean() > 0.1


def test_plans_are_as_good_as_without_a_device(problems):
    settings = {"map": "exact", "particles": 8, "iterations": 5, "retries": 0}
    settings |= {"samples": 100, "planning_steps": 16, "inference": "tempered"}
    planner = make_planner("smp", "Placement", settings=settings)
    mine, other = planner.plan(problems, "cpu"), planner.plan(problems)
    assert [len(plan.trajectories) for plan in mine] == [8, 8]
    assert sum(plan.good.sum() for plan in mine) >= sum(plan.good.sum() for plan in other) - 2
    again = planner.plan(problems, "cpu")
    np.testing.assert_array_equal(again[1].trajectories, mine[1].trajectories)
