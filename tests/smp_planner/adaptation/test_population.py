"""What is known of the particles of a population stays theirs."""

import numpy as np
import pytest
import torch

from smp_planner.adaptation import Runs
from smp_planner.adaptation.population import Members, Population
from smp_planner.inference import SETTINGS

STEPS = 12


class Far:
    """A cost of paths in the plane: a quarter of the fourth power of the distance to a point."""

    steps, pins = STEPS, np.array([0.0, 1.0])

    def evaluate(self, trajectories, progress):
        off = trajectories - 0.3
        return 0.25 * (off**4).sum(axis=(1, 2)), off**3

    def weighted_sum(self, trajectories):
        return self.evaluate(trajectories, 1.0)[0]


@pytest.fixture
def population(prior):
    generator = torch.Generator().manual_seed(0)
    parts = [
        Members.of(
            Runs.of([prior], STEPS),
            torch.randn(count, prior.rank, generator=generator, dtype=torch.float64),
            SETTINGS["tempered"],
        )
        for count in (5, 0, 3)
    ]
    return Population(parts, Far())


def test_gradients_are_those_of_autograd(population, prior):
    population.evaluate()
    for part in population.present:
        latent = torch.from_numpy(part.particles).requires_grad_()
        paths = prior.trajectory(prior.unwhiten(latent), STEPS)
        value = 0.25 * ((paths - 0.3) ** 4).sum((1, 2))
        value.sum().backward()
        np.testing.assert_allclose(part.value, value.detach().numpy(), rtol=1e-10)
        np.testing.assert_allclose(part.gradient, latent.grad.numpy(), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(population.weighted_sums(), population.values)


def test_particles_that_are_taken_bring_what_is_known_and_others_can_be_evaluated_alone(population):
    population.evaluate()
    first, second = population.present
    value, gradient = first.value.copy(), first.gradient.copy()
    chosen = np.array([0, 2, 2, 4])
    first.take(chosen)
    np.testing.assert_array_equal(first.value, value[chosen])
    np.testing.assert_array_equal(first.gradient, gradient[chosen])
    assert all(average.shape == (1, *first.particles.shape) for average in first.memory)
    first.particles[2] += 0.1
    second.particles[:] += 0.1
    population.evaluate_some([np.array([2]), np.arange(3)])
    partly = [(part.value.copy(), part.gradient.copy()) for part in (first, second)]
    population.evaluate()
    for part, (value, gradient) in zip((first, second), partly, strict=True):
        np.testing.assert_allclose(value, part.value)
        np.testing.assert_allclose(gradient, part.gradient)


def test_a_gradient_that_is_not_finite_is_refused(population):
    population.present[0].particles[1, 0] = np.nan
    with pytest.raises(ValueError, match="gradient must be finite"):
        population.evaluate()
