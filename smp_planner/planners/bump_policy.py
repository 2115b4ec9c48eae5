"""The policy of `mp_rl` and its kin: from a scene to a distribution over bumps on the mean.

An action is one choice of a component of the prior, such as a side, and the numbers of
`smp_planner.planning.bumps` for its conditioned mean. Their distribution is a mixture: a choice of
a component and of one of its heads, and for each head a Gaussian with independent coordinates. Of
`mp_rl` all of it comes from a network over the set of obstacles (Zaheer et al. 2017, "Deep Sets",
with mean and greatest value as the pooling): every obstacle is seen together with the hand's path
along the conditioned mean, in the obstacle's own frame. `detour` sees nothing: its distribution is
a constant.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from torch import Tensor, nn

from smp_gym.arrays import FloatArray, IntArray
from smp_gym.robot.kinematics import end_effector_pose
from smp_gym.scene import SHAPES, Obstacle
from smp_planner.planning.bumps import BumpedMean

__all__ = [
    "ActionDistribution",
    "BumpPolicy",
    "Looks",
    "NetworkShape",
    "hand_paths",
    "look",
    "rows_of",
    "stacked",
]

_PHASES = 8
"""Samples of the conditioned mean that the network sees."""

_CONTEXT = 9 * _PHASES
_ROW = len(SHAPES) + 3 + 9 + 3 + 3 + 3 * _PHASES

_LENGTH = 0.3
"""m, unit of lengths in the network."""

_LEAST_STD = 0.05
"""rad, standard deviation of actions at least."""

Numbers = NDArray[np.float32]


@dataclass(frozen=True)
class NetworkShape:
    """Sizes of a policy.

    Attributes:
        actions: F, numbers of an action.
        components: of the prior.
        sees: whether there is a network over obstacles; if not, the distribution is a constant.
        width: units of the layers that each obstacle passes.
        heads: H, Gaussians of a component.
    """

    actions: int
    components: int
    sees: bool = True
    width: int = 128
    heads: int = 1

    def component_of(self, gaussian: IntArray) -> IntArray:
        """Return the components of the prior that Gaussians of `ActionDistribution` are of."""
        return gaussian // self.heads


class Looks(NamedTuple):
    """What the network sees of B scenes.

    Attributes:
        context: (B, C, 72) configurations and hand positions along each component's mean.
        rows: (B, C, M, R) an obstacle each, as seen from that mean; zero where there is none.
        present: (B, M) whether there is one.
    """

    context: Tensor
    rows: Tensor
    present: Tensor


def _seen_of(means: Sequence[BumpedMean]) -> FloatArray:
    """Return the configurations (C, 8, 6) rad of means that the network sees."""
    chosen = np.linspace(0, len(means[0].mean) - 1, _PHASES).round().astype(np.int64)
    return np.stack([each.mean[chosen] for each in means])


def hand_paths(means: Sequence[BumpedMean]) -> FloatArray:
    """Return the positions (C, 8, 3) m of the hand along means."""
    return np.asarray(end_effector_pose(_seen_of(means))[..., :3, 3])


def look(means: Sequence[BumpedMean], obstacles: Sequence[Obstacle]) -> tuple[Numbers, Numbers]:
    """Return what the network sees of one scene: context (C, 72) and rows (C, M, R).

    Args:
        means: of the components.
        obstacles: of the scene, M of them, that are no fixtures of the task.
    """
    hand = hand_paths(means)
    parts = [_seen_of(means).reshape(len(means), -1), hand.reshape(len(means), -1) / _LENGTH]
    context = np.concatenate(parts, axis=1).astype(np.float32)
    return context, rows_of(hand, obstacles)


def rows_of(hand: FloatArray, obstacles: Sequence[Obstacle]) -> Numbers:
    """Return the rows (C, M, R) of obstacles as seen from paths of the hand (C, 8, 3) m."""
    if not obstacles:
        return np.zeros((len(hand), 0, _ROW), np.float32)
    position = np.array([o.position for o in obstacles])
    turn = Rotation.from_quat([o.quaternion for o in obstacles]).as_matrix()
    apart = hand[:, None] - position[None, :, None]
    own = np.einsum("cmpi,mij->cmpj", apart, turn).reshape(len(hand), len(obstacles), -1)
    kind = np.array([[o.shape == shape for shape in SHAPES] for o in obstacles], np.float64)
    size = np.array([o.size for o in obstacles])
    velocity = np.array([o.velocity for o in obstacles])
    fixed = [kind, position / _LENGTH, turn.reshape(-1, 9), size / _LENGTH, velocity / _LENGTH]
    alone = np.broadcast_to(np.concatenate(fixed, axis=1), (len(hand), len(obstacles), _ROW - 24))
    return np.concatenate([alone, own / _LENGTH], axis=2).astype(np.float32)


def stacked(seen: Sequence[tuple[Numbers, Numbers]]) -> Looks:
    """Return what is seen of B scenes, padded to as many obstacles as the fullest has."""
    most = max(1, max(rows.shape[1] for _, rows in seen))
    shape = (len(seen), len(seen[0][0]), most, _ROW)
    rows, present = np.zeros(shape, np.float32), np.zeros((len(seen), most), np.bool_)
    for index, (_, found) in enumerate(seen):
        rows[index, :, : found.shape[1]] = found
        present[index, : found.shape[1]] = True
    context = np.stack([context for context, _ in seen])
    return Looks(torch.from_numpy(context), torch.from_numpy(rows), torch.from_numpy(present))


class ActionDistribution(NamedTuple):
    """The distribution over actions in B scenes, a mixture of G = C H Gaussians.

    Attributes:
        choice: (B, G) logarithms of the Gaussians' probabilities, H of each component in turn.
        mean: (B, G, F).
        std: (F,).
    """

    choice: Tensor
    mean: Tensor
    std: Tensor

    def log_prob(self, gaussian: Tensor, action: Tensor) -> Tensor:
        """Return the log-density (B, N), less a constant, of N actions in each scene.

        Args:
            gaussian: (B, N) chosen.
            action: (B, N, F).
        """
        mean = torch.take_along_dim(self.mean, gaussian[..., None], 1)
        off = (action - mean) / self.std
        chosen = torch.take_along_dim(self.choice, gaussian, 1)
        return chosen - 0.5 * off.square().sum(-1) - self.std.log().sum()

    def sample(self, count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Return `count` indices of Gaussians (B, N) and actions (B, N, F)."""
        gaussian = torch.multinomial(self.choice.exp(), count, True, generator=generator)
        mean = torch.take_along_dim(self.mean, gaussian[..., None], 1)
        return gaussian, mean + self.std * torch.randn(mean.shape, generator=generator)


class BumpPolicy(nn.Module):
    """A distribution over actions for each scene.

    Args:
        shape: of the network.
        std: rad, standard deviation of actions before any training.

    Attributes:
        scale: (F,) by which an action is multiplied to be the numbers of a bumped mean.
    """

    scale: Tensor

    def __init__(self, shape: NetworkShape, std: float = 0.2) -> None:
        super().__init__()
        self.shape = shape
        self.log_std = nn.Parameter(torch.full((shape.actions,), math.log(std)))
        self.register_buffer("scale", torch.ones(shape.actions))
        if not shape.sees:
            self.constant = nn.Parameter(
                self._beginning(std).repeat(shape.components, 1).contiguous()
            )
            return
        width, half = shape.width, shape.width // 2
        self.context = nn.Sequential(
            nn.Linear(_CONTEXT, half), nn.ReLU(), nn.Linear(half, half), nn.ReLU()
        )
        self.each = nn.Sequential(
            nn.Linear(_ROW + half, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU()
        )
        self.whole = nn.Sequential(
            nn.Linear(2 * width + half, half),
            nn.ReLU(),
            nn.Linear(half, shape.heads * (1 + shape.actions)),
        )
        last = self.whole[-1]
        assert isinstance(last, nn.Linear)
        nn.init.zeros_(last.weight)
        with torch.no_grad():
            last.bias.copy_(self._beginning(std))

    def _beginning(self, std: float) -> Tensor:
        """Return the numbers (H (1 + F),) of untrained heads, about the conditioned mean.

        Several are as far apart as actions are drawn, for what is alike would learn the same.
        """
        heads, actions = self.shape.heads, self.shape.actions
        numbers = torch.zeros(heads, 1 + actions)
        if heads > 1:
            numbers[:, 1:] = std * torch.randn(heads, actions)
        return numbers.flatten()

    def forward(self, looks: Looks, components: Sequence[int] | None = None) -> ActionDistribution:
        """Return the distribution over actions in B scenes.

        Args:
            looks: what is seen of them.
            components: of the prior that these are of; by default all of them.
        """
        if self.shape.sees:
            context = self.context(looks.context)
            beside = context[:, :, None].expand(-1, -1, looks.rows.shape[2], -1)
            each = self.each(torch.cat([looks.rows, beside], -1))
            each = each * looks.present[:, None, :, None]
            count = looks.present.sum(1).clamp(min=1)[:, None, None]
            pooled = torch.cat([each.sum(2) / count, each.amax(2), context], -1)
            found = self.whole(pooled)
        else:
            constant = self.constant if components is None else self.constant[list(components)]
            found = constant.expand(len(looks.context), -1, -1)
        found = found.unflatten(-1, (self.shape.heads, -1)).flatten(1, 2)
        std = self.log_std.exp().clamp(min=_LEAST_STD)
        return ActionDistribution(found[..., 0].log_softmax(-1), found[..., 1:], std)
