"""Inference that goes on is the same as inference that was not interrupted."""

import numpy as np
import torch

from smp_planner.adaptation import Runs, SteinSettings
from smp_planner.adaptation.continuing import continue_stein, moved_memory
from smp_planner.movement_primitives import ProMP


class Pull:
    """A cost of paths in the plane: half the squared distance to a line."""

    def __init__(self, steps):
        self.steps, self.pins = steps, np.array([0.0, 1.0])
        self.scenes = (self,)

    def gradient(self, trajectories, progress):
        return trajectories - 0.5


def test_parts_amount_to_the_whole():
    rng = np.random.default_rng(0)
    paths = np.cumsum(rng.standard_normal((5, 40, 2)), axis=1) / 20.0
    runs = Runs.of([ProMP.fit(list(paths))], 20)
    latent = torch.from_numpy(rng.standard_normal((1, 6, runs.primitives[0].rank)))
    settings = SteinSettings()
    whole, _ = continue_stein(runs, latent, Pull(20), settings, 9, 0.05)
    half, memory = continue_stein(runs, latent, Pull(20), settings, 4, 0.05)
    rest, _ = continue_stein(runs, half, Pull(20), settings, 5, 0.05, memory, 4)
    torch.testing.assert_close(rest, whole)
    anew, _ = continue_stein(runs, half, Pull(20), settings, 5, 0.05)
    assert not torch.allclose(anew, whole)


def test_memory_moves_with_the_coordinates():
    """A mean direction is a displacement; squares follow a change of scale."""
    first, second = torch.randn(3, 4).double(), torch.rand(3, 4).double()
    change = torch.diag(torch.tensor([2.0, 0.5, 1.0, 3.0]).double())
    mean, square = moved_memory((first, second), change)
    torch.testing.assert_close(mean, first * change.diagonal())
    torch.testing.assert_close(square, second * change.diagonal() ** 2)
    assert moved_memory(None, change) is None
