"""Hamiltonian moves against posteriors in closed form and against the flow's own invariants."""

import numpy as np
import pytest
import torch

from smp_planner.inference.hamiltonian import Evaluated, hamiltonian_moves

CENTER = np.linspace(-2.0, 2.0, 12)
STD = np.where(np.arange(12) % 3 == 0, 0.3, 5.0)


def _observed(z):
    """A Gaussian observation of twelve standard normals, some of them sharp."""
    off = (z - CENTER) / STD
    return 0.5 * np.square(off).sum(axis=1), off / STD


def _start(z):
    return Evaluated(z, *_observed(z))


@pytest.mark.parametrize("leapfrogs", [1, 5])
def test_a_gaussian_posterior_is_reached_and_kept(leapfrogs):
    rng = np.random.default_rng(0)
    start = _start(rng.standard_normal((600, 12)))
    moves = 250 // leapfrogs
    kept, shares = hamiltonian_moves(
        start, _observed, rng, moves=moves, leapfrogs=leapfrogs, step=0.1
    )
    variance = 1.0 / (1.0 + STD**-2)
    z = (kept.particles - variance * CENTER / STD**2) / np.sqrt(variance)
    assert np.abs(z.mean(axis=0)).max() < 0.2
    assert np.abs(z.std(axis=0) - 1.0).max() < 0.15
    assert 0.6 < shares[-20:].mean() < 0.85
    np.testing.assert_allclose(kept.value, _observed(kept.particles)[0])
    np.testing.assert_allclose(kept.gradient, _observed(kept.particles)[1])


def test_without_a_likelihood_every_move_is_accepted_and_goes_far():
    """The flow of the prior is exact, so steps may be as long as they like."""
    rng = np.random.default_rng(1)
    z = rng.standard_normal((400, 30))

    def flat(particles):
        return np.zeros(len(particles)), np.zeros(particles.shape)

    kept, shares = hamiltonian_moves(
        Evaluated(z, *flat(z)), flat, rng, moves=3, leapfrogs=2, step=0.8
    )
    assert shares.tolist() == [1.0, 1.0, 1.0]
    assert np.abs(kept.particles.std() - 1.0) < 0.03
    assert abs((kept.particles * z).mean()) < 0.1


def test_same_generator_same_moves():
    start = _start(np.random.default_rng(2).standard_normal((5, 12)))
    first, second = (
        hamiltonian_moves(
            start, _observed, np.random.default_rng(3), moves=4, leapfrogs=3, step=0.1
        )[0].particles
        for _ in range(2)
    )
    np.testing.assert_array_equal(first, second)


def test_a_flow_that_diverges_is_refused_and_shortened():
    """Of a quartic potential, long steps fly off doubly exponentially."""

    def quartic(z):
        assert np.abs(z).max() <= 1e3
        return 5e3 * (z**4).sum(axis=1), 2e4 * z**3

    rng = np.random.default_rng(2)
    start = 0.1 * rng.standard_normal((500, 3))
    kept, shares = hamiltonian_moves(
        Evaluated(start, *quartic(start)), quartic, rng, moves=300, leapfrogs=8, step=1.0
    )
    assert shares[0] < 0.1
    assert shares[-20:].mean() > 0.3
    line = np.linspace(-1.0, 1.0, 4001)
    density = np.exp(-0.5 * line**2 - 5e3 * line**4)
    expected = (line**2 * density).sum() / density.sum()
    # 1500 draws, whose squares spread by about as much as their mean.
    assert np.mean(kept.particles**2) == pytest.approx(expected, rel=0.15)


class TorchDraws:
    """The numbers of one of NumPy's generators, as tensors."""

    def __init__(self, seed):
        self.rng = np.random.default_rng(seed)

    def standard_normal(self, size):
        return torch.from_numpy(self.rng.standard_normal(tuple(size)))

    def uniform(self, low, high, size):
        return torch.from_numpy(self.rng.uniform(low, high, tuple(size)))


def test_tensors_move_as_arrays_do():
    start = _start(np.random.default_rng(2).standard_normal((50, 12)))

    def observed(z):
        return tuple(torch.from_numpy(part) for part in _observed(z.numpy()))

    settings = {"moves": 6, "leapfrogs": 3, "step": 0.2}
    expected, shares = hamiltonian_moves(start, _observed, np.random.default_rng(3), **settings)
    tensors = Evaluated(*(torch.from_numpy(part) for part in start))
    found, same = hamiltonian_moves(tensors, observed, TorchDraws(3), **settings)
    np.testing.assert_allclose(found.particles, expected.particles)
    np.testing.assert_allclose(found.value, expected.value)
    np.testing.assert_allclose(same, shares)
    assert 0.0 < shares.mean() < 1.0
