"""A population that competes, against posteriors in closed form."""

import numpy as np
import pytest
import torch

from smp_planner.adaptation import Runs, adaptation

STEPS, PARTICLES = 30, 200
MIDDLE = STEPS // 2
PHASE = MIDDLE / (STEPS - 1)


class Observed:
    """The middle of a path, observed at one of two places with their shares, each 0.1 wide."""

    steps = STEPS
    pins = np.array([0.0, 1.0])
    std = 0.1

    def __init__(self, *places):
        self.places = np.array([place for place, _ in places])
        self.shares = np.array([share for _, share in places])

    def evaluate(self, trajectories, progress):
        off = trajectories[:, None, MIDDLE] - self.places
        log = np.log(self.shares) - 0.5 * np.square(off / self.std).sum(axis=-1)
        value = np.logaddexp.reduce(log, axis=1)
        gradient = np.zeros(trajectories.shape)
        belongs = np.exp(log - value[:, None])[..., None]
        gradient[:, MIDDLE] = (belongs * off / self.std**2).sum(axis=1)
        return -value, gradient

    def weighted_sum(self, trajectories):
        return self.evaluate(trajectories, 1.0)[0]


def adapted(priors, scene, seed=0, draws=4 * PARTICLES, **settings):
    """Return the particles of each part."""
    method = adaptation("smp", inference="tempered", **settings)
    generator = torch.Generator().manual_seed(seed)
    latent = [
        torch.randn(draws // len(priors), p.rank, generator=generator, dtype=torch.float64)
        for p in priors
    ]
    return method.jointly(
        [Runs.of([prior], STEPS) for prior in priors],
        latent,
        scene,
        np.random.default_rng(seed),
        method.settings,
        PARTICLES,
    )


def middles(prior, latent):
    return prior.trajectory(prior.unwhiten(latent), STEPS)[:, MIDDLE].numpy()


def test_a_gaussian_posterior_has_its_mean_and_its_spread(prior):
    place = np.array([0.3, -0.2])
    (latent,) = adapted([prior], Observed((place, 1.0)))
    exact = prior.condition(PHASE, torch.from_numpy(place), torch.full((2,), 0.1**2))
    mean, covariance = (value.numpy() for value in exact.marginal(PHASE))
    found = middles(prior, latent)
    std = np.sqrt(np.diag(covariance))
    assert np.abs(found.mean(axis=0) - mean).max() < 0.25 * std.max()
    assert np.abs(found.std(axis=0) / std - 1.0).max() < 0.2
    # What is not observed keeps the spread of the prior.
    whole = exact.whiten(prior.unwhiten(latent))
    assert whole.std().item() == pytest.approx(1.0, abs=0.1)


def test_modes_have_their_shares(prior):
    """Two places as likely under the prior, observed with shares of 0.8 and 0.2.

    Repulsion takes some particles from the full mode to the other, so shares come out more even.
    """
    scene = Observed(((0.35, 0.0), 0.8), ((-0.35, 0.0), 0.2))
    shares = [
        (middles(prior, adapted([prior], scene, seed)[0])[:, 0] > 0.0).mean() for seed in range(6)
    ]
    assert np.mean(shares) == pytest.approx(0.8, abs=0.1)


def test_parts_share_the_particles_by_their_evidence(prior):
    """What is observed decides between priors, however many draws each began with."""
    other = prior.condition(1.0, torch.tensor([0.8, 0.0], dtype=torch.float64))
    place = torch.tensor([0.35, 0.0], dtype=torch.float64)
    evidence = []
    for part in (prior, other):
        mean, covariance = part.marginal(PHASE)
        density = torch.distributions.MultivariateNormal(mean, covariance + 0.01 * torch.eye(2))
        evidence.append(float(density.log_prob(place).exp()))
    scene = Observed((place.numpy(), 1.0))
    shares = [len(adapted([prior, other], scene, seed)[0]) / PARTICLES for seed in range(4)]
    assert np.mean(shares) == pytest.approx(evidence[0] / sum(evidence), abs=0.06)


def test_parts_of_different_ranks_each_have_the_spread_of_their_posterior(prior):
    """Moves take all parts at once, those of a lower rank with coordinates that do not count."""
    end = torch.tensor([0.1, 0.0], dtype=torch.float64)
    other = prior.condition(1.0, end)
    assert other.rank < prior.rank
    place = torch.tensor([0.2, 0.1], dtype=torch.float64)
    found = adapted([prior, other], Observed((place.numpy(), 1.0)))
    for part, latent in zip((prior, other), found, strict=True):
        assert len(latent) > PARTICLES // 5
        exact = part.condition(PHASE, place, torch.full((2,), 0.1**2, dtype=torch.float64))
        whole = exact.whiten(part.unwhiten(latent))
        assert whole.std().item() == pytest.approx(1.0, abs=0.1)
        assert whole.mean(0).abs().max().item() < 0.5


def test_a_part_in_a_dead_end_loses_all_particles(prior):
    far = prior.condition(PHASE, torch.tensor([-0.9, 0.9], dtype=torch.float64))
    alive, dead = adapted([prior, far], Observed(((0.3, 0.0), 1.0)))
    assert (len(alive), len(dead)) == (PARTICLES, 0)


def test_the_same_generator_gives_the_same_particles_and_a_deadline_that_is_over_fewer(prior):
    scene = Observed(((0.3, 0.0), 1.0))
    first, second = (adapted([prior], scene, iterations=12)[0] for _ in range(2))
    np.testing.assert_array_equal(first, second)
    assert adapted([prior], scene, draws=PARTICLES, iterations=1)[0].shape == first.shape


def test_it_cannot_stop_early_and_needs_whitened_particles():
    with pytest.raises(ValueError, match="early_stop must be off with inference 'tempered'"):
        adaptation("smp", inference="tempered", early_stop=True)
