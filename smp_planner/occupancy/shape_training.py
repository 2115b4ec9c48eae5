"""Training of the shape networks: regression of the exact distance, once for all scenes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from smp_gym.geometry.distance import local_distance
from smp_gym.geometry.registry import REGISTRY
from smp_planner.occupancy.occupancy_map import TRUNCATION
from smp_planner.occupancy.shape_networks import NETWORK_SHAPES, ShapeNetworks, face_offsets
from smp_planner.torch_threads import one_thread

__all__ = ["sample_shape_distances", "train_shape_networks"]

SIZE_RANGE = (0.0025, 0.30)
"""Half-extents, m, of the bodies that a network is trained on."""

_INPUT_GAIN = 2.0
"""Factor on the first layer's initial weights, for edges are sharper than what it starts with."""

_HISTORY = 50


def sample_shape_distances(
    shape: str, count: int, rng: np.random.Generator, truncation: float = TRUNCATION
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Draw points around random bodies of one shape, and their exact distance.

    Half-extents are log-uniform over `SIZE_RANGE`. Points are uniform within the truncation
    distance of the body's bounding box, thinned far from the surface.

    Args:
        shape: one of those with a network.
        count: how many.
        rng: source of randomness.
        truncation: m.

    Returns:
        inputs (count, 3) as of `face_offsets`, and distances (count,) in units of the truncation.

    Raises:
        ValueError: no such shape.
    """
    if shape not in NETWORK_SHAPES:
        raise ValueError(f"shape must be one of {', '.join(NETWORK_SHAPES)}; got {shape!r}")
    smallest, largest = SIZE_RANGE
    inputs, targets = np.empty((0, 3)), np.empty(0)
    while len(targets) < count:
        sizes = smallest * np.power(largest / smallest, rng.random((2 * count, 3)))
        sizes = REGISTRY[shape].fitted(sizes)
        points = rng.uniform(-1.0, 1.0, sizes.shape) * (sizes + truncation)
        distance = local_distance(points, shape, sizes) / truncation
        near = np.exp(-np.square(distance / 0.4))
        keep = (np.abs(distance) < 1.0) & (rng.random(len(near)) < 0.2 + 0.8 * near)
        offsets = face_offsets(points, shape, sizes, truncation)
        inputs = np.concatenate([inputs, offsets[keep]])
        targets = np.concatenate([targets, distance[keep]])
    return inputs[:count], targets[:count]


def _train_one(
    shape: str,
    hidden: int,
    rounds: int,
    iterations: int,
    samples: int,
    truncation: float,
    generator: torch.Generator,
    rng: np.random.Generator,
    report: Callable[[str, int, float], None],
) -> list[NDArray[np.float32]]:
    # L-BFGS in double precision: ten times more exact here than Adam in the same time.
    layers = [nn.Linear(a, b, dtype=torch.float64) for a, b in ((3, hidden), (hidden, hidden))]
    layers.append(nn.Linear(hidden, 1, dtype=torch.float64))
    with torch.no_grad():
        for layer in layers:
            nn.init.xavier_uniform_(layer.weight, generator=generator)
            nn.init.uniform_(layer.bias, -0.5, 0.5, generator=generator)
        layers[0].weight *= _INPUT_GAIN
    network = nn.Sequential(layers[0], nn.Tanh(), layers[1], nn.Tanh(), layers[2])
    for done in range(rounds):
        # Fresh points in each round, or the network learns the sample.
        inputs, targets = map(
            torch.from_numpy, sample_shape_distances(shape, samples, rng, truncation)
        )
        optimiser = torch.optim.LBFGS(
            network.parameters(),
            max_iter=iterations,
            history_size=_HISTORY,
            tolerance_grad=1e-12,
            tolerance_change=1e-15,
            line_search_fn="strong_wolfe",
        )

        def loss(
            inputs: Tensor = inputs,
            targets: Tensor = targets,
            optimiser: torch.optim.Optimizer = optimiser,
        ) -> Tensor:
            optimiser.zero_grad()
            value = torch.mean((network(inputs)[:, 0] - targets) ** 2)
            value.backward()
            return value

        optimiser.step(loss)
        report(shape, done + 1, float(loss().detach().sqrt()) * truncation)
    parameters = [p.detach().numpy().astype(np.float32) for p in network.parameters()]
    parameters[4] = parameters[4][0]
    parameters[5] = parameters[5].reshape(())
    return parameters


@one_thread()
def train_shape_networks(
    hidden: int = 16,
    rounds: int = 8,
    iterations: int = 300,
    samples: int = 20_000,
    truncation: float = TRUNCATION,
    seed: int = 0,
    report: Callable[[str, int, float], None] = lambda shape, done, error: None,
) -> ShapeNetworks:
    """Train one network for each shape.

    Args:
        hidden: units in each of the two layers.
        rounds: rounds of L-BFGS, each on fresh points.
        iterations: iterations in each round.
        samples: points in each round.
        truncation: m.
        seed: of initial weights and points.
        report: called after each round with the shape, the rounds done and the RMS error in m.

    Raises:
        ValueError: `hidden`, `rounds`, `iterations` or `samples` is below 1.
    """
    positive = {"hidden": hidden, "rounds": rounds, "iterations": iterations, "samples": samples}
    for name, value in positive.items():
        if value < 1:
            raise ValueError(f"{name} must be at least 1, got {value}")
    trained = [
        _train_one(
            shape,
            hidden,
            rounds,
            iterations,
            samples,
            truncation,
            torch.Generator().manual_seed(seed),
            np.random.default_rng(seed),
            report,
        )
        for shape in NETWORK_SHAPES
    ]
    return ShapeNetworks(truncation, *(np.stack(arrays) for arrays in zip(*trained, strict=True)))
