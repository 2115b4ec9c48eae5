"""Inference that goes on is the same as inference that was not interrupted."""

import numpy as np
import torch

from smp_planner.adaptation import Runs, SteinSettings
from smp_planner.adaptation.continuing import continue_stein, moved_memory
from smp_planner.movement_primitives import ProMP

STEPS = 20


class Pull:
    """A cost of paths in the plane: half the squared distance to a line."""

    steps, pins = STEPS, np.array([0.0, 1.0])

    def evaluate(self, trajectories, progress):
        off = trajectories - 0.5
        return 0.5 * np.square(off).sum(axis=(1, 2)), off


def parts_of_two_ranks():
    """Return the priors of two parts, one of a lower rank, and particles of each."""
    rng = np.random.default_rng(0)
    paths = np.cumsum(rng.standard_normal((5, 40, 2)), axis=1) / 20.0
    prior = ProMP.fit(list(paths))
    priors = [prior, prior.condition(1.0, torch.tensor([0.1, 0.0], dtype=torch.float64))]
    return [Runs.of([part], STEPS) for part in priors], [
        torch.from_numpy(rng.standard_normal((count, part.rank)))
        for count, part in zip((6, 4), priors, strict=True)
    ]


def continued(runs, latent, iterations, memories=None, done=0):
    found = continue_stein(
        runs,
        latent,
        Pull(),
        SteinSettings(),
        iterations,
        0.05,
        memories or [None] * len(runs),
        [done] * len(runs),
    )
    particles, memories = zip(*found, strict=True)
    return particles, memories


def test_parts_amount_to_the_whole():
    runs, latent = parts_of_two_ranks()
    whole, _ = continued(runs, latent, 9)
    half, memory = continued(runs, latent, 4)
    rest, _ = continued(runs, half, 5, memory, 4)
    anew, _ = continued(runs, half, 5)
    for part in range(2):
        torch.testing.assert_close(rest[part], whole[part])
        assert not torch.allclose(anew[part], whole[part])


def test_parts_do_not_see_each_other():
    runs, latent = parts_of_two_ranks()
    together, _ = continued(runs, latent, 5)
    for part in range(2):
        (alone,), _ = continued(runs[part : part + 1], latent[part : part + 1], 5)
        torch.testing.assert_close(together[part], alone)


def test_memory_moves_with_the_coordinates():
    """A mean direction is a displacement; squares follow a change of scale."""
    first, second = torch.randn(3, 4).double(), torch.rand(3, 4).double()
    change = torch.diag(torch.tensor([2.0, 0.5, 1.0, 3.0]).double())
    mean, square = moved_memory((first, second), change)
    torch.testing.assert_close(mean, first * change.diagonal())
    torch.testing.assert_close(square, second * change.diagonal() ** 2)
    assert moved_memory(None, change) is None
