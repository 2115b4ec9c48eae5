"""Stein's adaptation of a primitive, on a target with a closed form: when it may stop."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from smp_planner.adaptation import Runs, adaptation
from smp_planner.inference import SETTINGS, State, SVGDSettings, converged

STEPS = 30


class Attractor:
    """Draws the middle of a path to one point, as an observation with standard deviation 0.1."""

    steps = STEPS
    pins = np.array([0.0, 1.0])

    def __init__(self):
        self.calls = 0
        self.scenes = (self,)

    def gradient(self, trajectories, progress):
        self.calls += 1
        gradient = torch.zeros_like(trajectories)
        gradient[:, :, STEPS // 2] = (trajectories[:, :, STEPS // 2] - 0.3) / 0.1**2
        return gradient

    def obstacle_gradient(self, trajectories, progress):
        return np.zeros_like(trajectories)


class Verdict:
    """Says of a given share of the particles that they are good, and keeps what it is asked."""

    def __init__(self, share):
        self.share, self.asked = share, []

    def __call__(self, latent):
        self.asked.append(latent.clone())
        count = latent.shape[1]
        return np.arange(count)[None] < self.share * count


def adapted(prior, method, good=None, runs=1):
    """Return the particles and how many iterations they took."""
    target, generator = Attractor(), torch.Generator().manual_seed(0)
    latent = torch.randn(40, prior.rank, generator=generator, dtype=torch.float64)
    found = method.adapt(
        Runs.of([prior] * runs, STEPS),
        latent.expand(runs, -1, -1),
        target,
        (),
        method.settings,
        good,
    )
    return found[0], target.calls


def test_a_run_has_converged_when_it_is_annealed_and_at_rest():
    settings, zeros = SVGDSettings(iterations=10, annealing=0.7, tolerance=0.1), torch.zeros(2, 2)
    assert not converged(State(zeros, None, 6), 0.0, settings)
    assert not converged(State(zeros, None, 7), 0.1, settings)
    assert converged(State(zeros, None, 7), 0.09, settings)
    assert converged(State(zeros, None, 1), 0.09, replace(settings, annealing=0.0))


@pytest.mark.parametrize("inference", ["svgd", "raw", "cyclic", "no_annealing"])
def test_it_stops_once_the_particles_rest_and_enough_of_them_are_good(prior, inference):
    method = adaptation("smp", inference=inference, early_stop=True, iterations=200)
    whole, iterations = adapted(
        prior, adaptation("smp", inference=inference, iterations=200), Verdict(1.0)
    )
    assert iterations == 200
    verdict = Verdict(0.9)
    stopped, iterations = adapted(prior, method, verdict)
    settings = SETTINGS[inference]
    assert settings.annealing * 200 <= iterations < 200
    assert len(verdict.asked) == 1
    torch.testing.assert_close(stopped, verdict.asked[0][0])
    # Each movement that is left out would have been smaller than the tolerance.
    movement = (whole - stopped).square().mean(-1).sqrt().mean()
    assert float(movement) < settings.tolerance * (200 - iterations)
    middle = prior.trajectory(prior.unwhiten(stopped), STEPS)[:, STEPS // 2].mean(0)
    exact = prior.condition(
        (STEPS // 2) / (STEPS - 1), torch.full((2,), 0.3), torch.full((2,), 0.1**2)
    ).marginal((STEPS // 2) / (STEPS - 1))[0]
    torch.testing.assert_close(middle, exact, atol=0.02, rtol=0)


def test_it_goes_on_to_the_end_if_too_few_are_good_and_asks_once(prior):
    svgd = {"inference": "svgd", "iterations": 100}
    method = adaptation("smp", **svgd, early_stop=True, good_share=0.9)
    verdict = Verdict(0.8)
    to_the_end, iterations = adapted(prior, method, verdict)
    assert (iterations, len(verdict.asked)) == (100, 1)
    without, _ = adapted(prior, adaptation("smp", **svgd))
    assert torch.equal(to_the_end, without)
    few = adaptation("smp", **svgd, early_stop=True, good_share=0.5)
    assert adapted(prior, few, Verdict(0.8))[1] < 100


def test_nobody_is_asked_unless_it_is_wanted(prior):
    verdict = Verdict(1.0)
    svgd = {"inference": "svgd", "iterations": 100}
    assert adapted(prior, adaptation("smp", **svgd), verdict)[1] == 100
    assert verdict.asked == []
    assert adapted(prior, adaptation("smp", **svgd, early_stop=True))[1] == 100


def test_a_share_or_a_tolerance_out_of_range_is_an_error():
    with pytest.raises(ValueError, match="good_share"):
        adaptation("smp", good_share=0.0)
    with pytest.raises(ValueError, match="tolerance must be positive and finite, got 0"):
        SVGDSettings(tolerance=0.0)


def test_runs_of_a_batch_do_not_see_each_other(prior):
    alone, _ = adapted(prior, adaptation("smp", iterations=20))
    batched, _ = adapted(prior, adaptation("smp", iterations=20), runs=3)
    torch.testing.assert_close(batched, alone, rtol=0, atol=1e-9)


def test_runs_are_the_primitives_that_they_stack(prior):
    other = prior.condition(1.0, torch.full((2,), 0.5, dtype=torch.float64))
    runs = Runs.of([other, other], STEPS)
    latent = torch.randn(2, 5, other.rank, dtype=torch.float64)
    weights = runs.unwhiten(latent)
    torch.testing.assert_close(weights[1], other.unwhiten(latent[1]))
    torch.testing.assert_close(runs.whiten(weights), latent)
    torch.testing.assert_close(runs.score(weights)[0], other.score(weights[0]))
    torch.testing.assert_close(runs.trajectories(weights)[1], other.trajectory(weights[1], STEPS))
    gradient = torch.randn(2, 5, STEPS, 2, dtype=torch.float64)
    expected = other.pull_back(gradient[1], STEPS)
    torch.testing.assert_close(runs.pull_back(gradient)[1], expected)
