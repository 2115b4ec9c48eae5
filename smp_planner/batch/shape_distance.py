"""Signed distance of the obstacle shapes and its gradient as tensors, in the frame of the body.

The kernels of `smp_gym.geometry` say the same for one point; tests hold the two together.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import torch
from torch import Tensor

__all__ = ["LOCAL_DISTANCES", "Profile", "profile_distance"]

Profile = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]
"""Map from points (..., 3) and half-extents (..., 3) to coordinates (..., 3), each measured from
the surface outwards along directions that are orthogonal, and to these directions (..., 3, 3)."""

_ABSENT = -1e3
"""A coordinate that a shape does not have: far inside."""

_LEAST = 1e-20
"""Squared length under which a vector has no direction."""


def _direction(vector: Tensor) -> tuple[Tensor, Tensor]:
    """Return lengths (...) and unit vectors (..., d), the first axis for those of no length."""
    square = vector.square().sum(-1)
    length = square.clamp_min(_LEAST).sqrt()
    first = torch.zeros_like(vector)
    first[..., 0] = 1.0
    unit = torch.where((square > _LEAST)[..., None], vector / length[..., None], first)
    return length, unit


def _box(points: Tensor, size: Tensor) -> tuple[Tensor, Tensor]:
    sign = torch.where(points < 0.0, -1.0, 1.0).to(points)
    return points.abs() - size, torch.diag_embed(sign)


def _cylinder(points: Tensor, size: Tensor) -> tuple[Tensor, Tensor]:
    across, outwards = _direction(points[..., :2])
    height = points[..., 2]
    absent, zero = torch.full_like(height, _ABSENT), torch.zeros_like(height)
    sign = torch.where(height < 0.0, -1.0, 1.0).to(points)
    coordinates = torch.stack([across - size[..., 0], absent, height.abs() - size[..., 2]], -1)
    side = torch.stack([outwards[..., 0], outwards[..., 1], zero], -1)
    end = torch.stack([zero, zero, sign], -1)
    return coordinates, torch.stack([side, torch.zeros_like(side), end], -2)


def _sphere(points: Tensor, size: Tensor) -> tuple[Tensor, Tensor]:
    length, outwards = _direction(points)
    absent, nothing = torch.full_like(length, _ABSENT), torch.zeros_like(outwards)
    coordinates = torch.stack([length - size[..., 0], absent, absent], -1)
    return coordinates, torch.stack([outwards, nothing, nothing], -2)


LOCAL_DISTANCES: Mapping[str, Profile] = MappingProxyType(
    {"box": _box, "cylinder": _cylinder, "sphere": _sphere}
)
"""Profiles by name of the shape, in the order of their codes in `Tables`."""


def profile_distance(coordinates: Tensor, directions: Tensor) -> tuple[Tensor, Tensor]:
    """Return distance (...) and gradient (..., 3) of the coordinates of a `Profile`.

    Args:
        coordinates: (..., 3) m.
        directions: (..., 3, 3), the direction of each coordinate in a row.
    """
    beyond = coordinates.clamp_min(0.0)
    square = beyond.square().sum(-1)
    outside = square > 0.0
    length = torch.where(outside, square, torch.ones_like(square)).sqrt()
    deepest, index = coordinates.max(-1)
    distance = torch.where(outside, length, deepest)
    inner = torch.nn.functional.one_hot(index, 3).to(coordinates)
    slope = torch.where(outside[..., None], beyond / length[..., None], inner)
    return distance, (slope[..., None] * directions).sum(-2)
