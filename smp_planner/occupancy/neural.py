"""The paper's map (Eq. 12): a fully connected network that learns occupancy from labelled points.

Tanh between the layers, a sigmoid at the output, trained anew for each scene, from points of any
source that are labelled free or occupied. The sigmoid's logit is no distance (it saturates within
centimetres of the surface), so a sphere's radius cannot be compared with it. Therefore
`PointNetworkMap` computes, once per scene, the distance to the network's surface p = 1/2, and
serves it like any other map. `ShapeNetworkMap` is the faster and more exact default where the
obstacles are known as bodies.

Training and evaluation use as many threads as torch is set to; worker processes set it to one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import nn

from smp_gym.arrays import Float32Array
from smp_gym.geometry.distance import PackedObstacles, check_points, signed_distance
from smp_gym.scene import Obstacle
from smp_gym.untrusted_files import read_file
from smp_planner.occupancy.archive import read_archive, write_archive
from smp_planner.occupancy.grid import WORKSPACE, DistanceGrid, GridMap, grid_nodes
from smp_planner.occupancy.occupancy_map import TRUNCATION
from smp_planner.occupancy.redistancing import redistance
from smp_planner.torch_threads import one_thread

__all__ = ["PointNetwork", "PointNetworkMap", "sample_labelled_points", "train_map"]

INFLATION = 0.02
"""Default distance, m, by which bodies are grown before points are labelled."""

_HEADER = {"format": "smp-point-network", "version": 1}
_CHUNK = 1 << 16
SAMPLING_BAND = 0.03
"""Metres from the labelled surface within which most of the points are drawn."""

UNIFORM_SHARE = 0.25
"""Share of the points that is drawn from the whole workspace."""

_PEAK_LEARNING_RATE = 1e-2


@dataclass(frozen=True)
class PointNetwork:
    """A trained classifier of points.

    Attributes:
        weights: matrices of the L layers, (H, 3), (H, H) ..., (1, H), float32.
        biases: vectors of the L layers, (H,) ..., (1,).
        center: (3,) m; inputs are (point - center) / scale.
        scale: m.
        inflation: m, what counted as occupied: all within this distance of a body.
    """

    weights: tuple[Float32Array, ...]
    biases: tuple[Float32Array, ...]
    center: NDArray[np.float64]
    scale: float
    inflation: float = 0.0

    def __post_init__(self) -> None:
        width = 3
        if not self.weights or len(self.weights) != len(self.biases):
            raise ValueError(
                "PointNetwork needs as many weights as biases, at least one, got "
                f"{len(self.weights)} and {len(self.biases)}"
            )
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            rows = 1 if i == len(self.weights) - 1 else weight.shape[0]
            if weight.shape != (rows, width) or bias.shape != (rows,):
                raise ValueError(
                    f"PointNetwork layer {i} must map {width} inputs to {rows} outputs, got weight "
                    f"{weight.shape} and bias {bias.shape}"
                )
            if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
                raise ValueError(f"PointNetwork layer {i} must be finite")
            width = rows
        if np.shape(self.center) != (3,) or not np.isfinite(self.center).all():
            raise ValueError(f"PointNetwork.center must be 3 finite numbers, got {self.center}")
        if not (math.isfinite(self.scale) and self.scale > 0.0):
            raise ValueError(f"PointNetwork.scale must be positive, got {self.scale}")
        if not (math.isfinite(self.inflation) and self.inflation >= 0.0):
            raise ValueError(f"PointNetwork.inflation must not be negative, got {self.inflation}")

    def logit(self, points: ArrayLike) -> NDArray[np.float64]:
        """Return the log odds of occupancy (...) at points (..., 3) m; no distance (see above).

        Raises:
            ValueError: `points` has the wrong shape or is not finite.
        """
        array = check_points(points)
        inputs = ((array.reshape(-1, 3) - self.center) / self.scale).astype(np.float32)
        layers = [
            (torch.from_numpy(w).T, torch.from_numpy(b))
            for w, b in zip(self.weights, self.biases, strict=True)
        ]
        result = np.empty(len(inputs))
        with torch.no_grad():
            for start in range(0, len(inputs), _CHUNK):
                x = torch.from_numpy(inputs[start : start + _CHUNK])
                for weight, bias in layers[:-1]:
                    x = torch.addmm(bias, x, weight).tanh_()
                x = torch.addmm(layers[-1][1], x, layers[-1][0])
                result[start : start + _CHUNK] = x[:, 0].numpy()
        return result.reshape(array.shape[:-1])

    def probability(self, points: ArrayLike) -> NDArray[np.float64]:
        """Return f_map of Eq. (12), the probability that a point (..., 3) m is occupied, (...).

        Raises:
            ValueError: `points` has the wrong shape or is not finite.
        """
        return np.asarray(0.5 * (1.0 + np.tanh(0.5 * self.logit(points))))

    def save(self, path: str | Path) -> None:
        """Write an `.npz` without pickled objects, which `load` gives back exactly."""
        arrays = {f"weight{i}": w for i, w in enumerate(self.weights)}
        arrays |= {f"bias{i}": b for i, b in enumerate(self.biases)}
        frame = np.array([*self.center, self.scale, self.inflation])
        write_archive(path, _HEADER, {"frame": frame, **arrays})

    @classmethod
    def load(cls, path: str | Path) -> PointNetwork:
        """Read what `save` wrote.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: it is damaged, is something else, or is of another version.
        """
        arrays = read_archive(read_file(path), str(path), _HEADER)
        layers = (len(arrays) - 1) // 2
        try:
            frame = arrays["frame"].astype(np.float64)
            weights = tuple(arrays[f"weight{i}"].astype(np.float32) for i in range(layers))
            biases = tuple(arrays[f"bias{i}"].astype(np.float32) for i in range(layers))
            return cls(weights, biases, frame[:3], float(frame[3]), float(frame[4]))
        except (KeyError, IndexError) as error:
            raise ValueError(f"{path} lacks a part of a point network: {error}") from error


def sample_labelled_points(
    obstacles: Sequence[Obstacle],
    count: int,
    rng: np.random.Generator,
    inflation: float = INFLATION,
    workspace: tuple[Sequence[float], Sequence[float]] = WORKSPACE,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Draw points of a scene, labelled occupied or free.

    A quarter is uniform over the workspace, the rest lies around the surfaces. Growing the bodies
    before labelling lets the network see walls that are thinner than it can resolve; the map takes
    the growth off again.

    Args:
        obstacles: at least one body.
        count: how many points.
        rng: source of randomness.
        inflation: m; points within this distance of a body are labelled occupied.
        workspace: lower and upper corner of the box that the points are in, m.

    Returns:
        points (count, 3) m and labels (count,), True for occupied.

    Raises:
        ValueError: no obstacle reaches into the workspace, or `count` or `inflation` is negative.
    """
    if count < 0 or not inflation >= 0.0:
        raise ValueError(f"count and inflation must not be negative, got {count} and {inflation}")
    lower, upper = (np.asarray(corner, np.float64) for corner in workspace)
    packed = PackedObstacles.of(obstacles)
    reach = packed.half_extents + inflation + SAMPLING_BAND
    low = np.maximum(packed.position - reach, lower)
    high = np.minimum(packed.position + reach, upper)
    present = np.flatnonzero((low < high).all(axis=1))
    if not len(present):
        raise ValueError(
            "obstacles must hold a body in the workspace, or there is nothing to learn"
        )
    uniform = int(UNIFORM_SHARE * count)
    points = rng.uniform(lower, upper, (uniform, 3))
    while len(points) < count:
        body = rng.choice(present, count)
        drawn = rng.uniform(low[body], high[body])
        near = np.abs(signed_distance(drawn, packed) - inflation) < SAMPLING_BAND
        points = np.concatenate([points, drawn[near]])
    points = points[:count]
    return points, signed_distance(points, packed) <= inflation


@one_thread()
def train_map(
    points: ArrayLike,
    labels: ArrayLike,
    *,
    inflation: float = 0.0,
    hidden: Sequence[int] = (64, 64, 64),
    input_gain: float = 8.0,
    batch: int = 512,
    steps: int = 5000,
    seed: int = 0,
) -> PointNetwork:
    """Learn where a scene is occupied from labelled points (Eq. 12).

    Args:
        points: (N, 3) m.
        labels: (N,), True or 1 for occupied, False or 0 for free.
        inflation: m, by which bodies were grown before labelling; 0 for plain point clouds.
        hidden: units of each hidden layer. Depth helps, width does not.
        input_gain: factor on the first layer's initial weights. Larger resolves finer edges.
        batch: points in each step; small ones train faster.
        steps: steps of Adam, with one cycle of the learning rate.
        seed: of initial weights and order of points.

    Raises:
        ValueError: shapes disagree, a point is not finite, a label is not 0 or 1, all labels are of
            one class, or a number that must be positive is not.
    """
    array = check_points(points)
    target = np.asarray(labels)
    if array.ndim != 2 or target.shape != (len(array),):
        raise ValueError(
            f"points and labels must be (N, 3) and (N,), got {array.shape} and {target.shape}"
        )
    if not np.isin(target, (0, 1)).all():
        raise ValueError(f"labels must be 0 or 1, got {target[~np.isin(target, (0, 1))][0]}")
    occupied = int(np.count_nonzero(target))
    if occupied in (0, len(target)):
        raise ValueError(
            f"labels must hold free and occupied points, got {occupied} occupied of {len(target)}"
        )
    if not (math.isfinite(inflation) and inflation >= 0.0):
        raise ValueError(f"inflation must not be negative, got {inflation}")
    if batch < 1 or steps < 1 or not hidden or min(hidden) < 1:
        raise ValueError(
            f"batch, steps and hidden must be positive, got {batch}, {steps}, {hidden}"
        )
    lower, upper = array.min(axis=0), array.max(axis=0)
    center, scale = (lower + upper) / 2, float((upper - lower).max() / 2)
    if scale == 0.0:
        raise ValueError(f"points must not all be the same, got {array[0]} {len(array)} times")
    inputs = torch.from_numpy(((array - center) / scale).astype(np.float32))
    targets = torch.from_numpy(target.astype(np.float32))

    generator = torch.Generator().manual_seed(seed)
    widths = (3, *hidden, 1)
    layers = [nn.Linear(a, b) for a, b in pairwise(widths)]
    with torch.no_grad():
        for i, layer in enumerate(layers):
            bound = 1.0 / math.sqrt(widths[i])
            nn.init.uniform_(layer.weight, -bound, bound, generator=generator)
            nn.init.uniform_(layer.bias, -bound, bound, generator=generator)
        layers[0].weight *= input_gain
    modules: list[nn.Module] = [layers[0]]
    for layer in layers[1:]:
        modules += [nn.Tanh(), layer]
    network = nn.Sequential(*modules)
    optimiser = torch.optim.Adam(network.parameters())
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, _PEAK_LEARNING_RATE, total_steps=steps
    )
    loss = nn.BCEWithLogitsLoss()
    batch = min(batch, len(array))
    order, position = torch.randperm(len(array), generator=generator), 0
    for _ in range(steps):
        if position + batch > len(array):
            order, position = torch.randperm(len(array), generator=generator), 0
        chosen = order[position : position + batch]
        position += batch
        optimiser.zero_grad(set_to_none=True)
        loss(network(inputs[chosen])[:, 0], targets[chosen]).backward()
        optimiser.step()
        schedule.step()
    weights = tuple(layer.weight.detach().numpy().copy() for layer in layers)
    biases = tuple(layer.bias.detach().numpy().copy() for layer in layers)
    return PointNetwork(weights, biases, center, scale, inflation)


@dataclass(frozen=True)
class PointNetworkMap(GridMap):
    """The distance to the surface of a `PointNetwork`, an `OccupancyMap`.

    Attributes:
        grid: signed distance to the bodies: to its surface p = 1/2, plus its inflation.
        truncation: m, largest absolute value of the distance.
        network: the classifier.
    """

    network: PointNetwork

    @classmethod
    def of(
        cls,
        network: PointNetwork,
        workspace: tuple[Sequence[float], Sequence[float]] = WORKSPACE,
        spacing: float = 0.02,
        truncation: float = TRUNCATION,
    ) -> PointNetworkMap:
        """Compute the distance of a trained network over a workspace.

        Args:
            network: the classifier.
            workspace: as in `grid.bake`; outside, the value is that of the nearest boundary point.
            spacing: m; what is thinner, after inflation, may be lost.
            truncation: m.

        Raises:
            ValueError: `workspace` or `spacing` is out of range.
        """
        origin, nodes = grid_nodes(workspace, spacing)
        axes = [origin[i] + spacing * np.arange(nodes[i]) for i in range(3)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        # The level set lies `inflation` outside the bodies.
        level = redistance(network.logit(points), spacing, truncation + network.inflation)
        values = np.clip(level + np.float32(network.inflation), -truncation, truncation)
        return cls(DistanceGrid(origin, spacing, values), truncation, network)
